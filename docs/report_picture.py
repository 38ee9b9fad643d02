"""Picture of a report for the documentation: the top of the page in a browser window of desktop width, or a part of it.

python docs/report_picture.py REPORT.html docs/figures/report.png [SELECTOR]
"""

import io
import sys
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from headless_browser import Page, browser

WIDTH, HEIGHT, BORDER = 1280, 1950, 4

BOX = (
    "(() => {{ const box = document.querySelector({!r}).getBoundingClientRect(); "
    "return [box.x, box.y, box.right, box.bottom] }})()"
)

if browser() is None:
    sys.exit("Chromium must be installed (apt-get install chromium), got none")
with Page() as page:
    page.open(Path(sys.argv[1]), WIDTH)
    picture = Image.open(io.BytesIO(page.picture()))
    part = page.value(BOX.format(sys.argv[3])) if len(sys.argv) > 3 else None
left, top, right, bottom = (
    (0, 0, picture.width, min(HEIGHT, picture.height))
    if part is None
    else (round(part[0]) - BORDER, round(part[1]) - BORDER, round(part[2]) + BORDER, round(part[3]) + BORDER)
)
picture.convert("RGB").crop((left, top, right, bottom)).quantize(48).save(sys.argv[2], optimize=True)
sys.stdout.write(f"{sys.argv[2]}: {Path(sys.argv[2]).stat().st_size // 1000} kB\n")
