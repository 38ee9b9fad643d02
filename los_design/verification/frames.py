"""The camera's frames: that their sidebands keep every member stable, by two gains of the loop without them.

A camera's sample is held for N ticks, so a signal of frequency w is seen at its N images w + 2 pi k / (N dt), too. The
proofs are of the loop with the fundamental of that hold. Let s be the sum of the images that a sample takes, S the
response from what is added to the camera's measurement to that measurement (the fundamental's loop closed) and L the
one with the camera's own loop open, the hold in it. If a member had a solution that repeats itself from frame to frame
up to a factor of modulus 1, of frequency w within half of the frame rate, the other images would have
``y_k = L(w_k) s``, the first one ``s = S(w) sum_k y_k`` (k not 0), so that ::

    |s| <= |S(w)| sum_k |L(w_k)| |s|

With the product below 1 there is none: no multiplier of the periodic loop is on the unit circle. They move
continuously with the parameters, and those of the nominal loop are inside, by its eigenvalues. Premises: both gains are
proven over the box, S within half of the frame rate and L above it; the nominal eigenvalues are computed, not enclosed.
What the parameters change in the images of held commands above half of the tick rate is left out, as in every proof.
"""

from __future__ import annotations

from collections.abc import Mapping

SEEN, IMAGES = "frames, seen", "frames, images"
"""Names of the two gains: S within half of the frame rate, L above it."""
LIMITS = {SEEN: 3.0, IMAGES: 1e-3}
"""Of these gains: their product for all images is 0.06 at 50 Hz and below 1 from 3 Hz on: both are cheap to prove."""


def frames_share(levels: Mapping[str, float], ticks: int) -> float | None:
    """Bound of the part of a sample that comes back by its images, over the box; None where a gain is not proven.

    Parameters
    ----------
    levels : mapping of str to float
        Bounds of gains by name.
    ticks : int
        Ticks from one frame to the next; with a frame at every tick there are no images.

    Examples
    --------
    >>> frames_share({SEEN: 3.0, IMAGES: 1e-3}, 20)
    0.057
    """
    if ticks == 1:
        return 0.0
    if not set(LIMITS) <= set(levels):
        return None
    return (ticks - 1) * levels[SEEN] * levels[IMAGES]
