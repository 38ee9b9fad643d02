// Names for assistive technology that the theme does not give, and boxes that scroll can be reached by keyboard.
(() => {
  const name = () => {
    document.querySelector(".md-search")?.setAttribute("aria-label", "Search");
    document.querySelector(".md-search__options")?.setAttribute("aria-label", "Search options");
    document.querySelectorAll(".md-code__nav").forEach((nav, i) => nav.setAttribute("aria-label", `Code block ${i + 1}`));
    document.querySelectorAll("pre > code, .md-typeset__scrollwrap, div.math").forEach((box) => box.setAttribute("tabindex", "0"));
  };
  name();
  new MutationObserver(name).observe(document.body, { childList: true, subtree: true });
})();
