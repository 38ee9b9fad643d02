"""Picture of a report for the README: the top of the page in a browser window of desktop width.

python docs/report_picture.py REPORT.html docs/figures/report.png
"""

import io
import sys
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from headless_browser import Page, browser

WIDTH, HEIGHT = 1280, 2230

if browser() is None:
    sys.exit("Chromium must be installed (apt-get install chromium), got none")
with Page() as page:
    page.open(Path(sys.argv[1]), WIDTH)
    picture = Image.open(io.BytesIO(page.picture()))
picture = picture.convert("RGB").crop((0, 0, picture.width, min(HEIGHT, picture.height)))
picture.quantize(256).save(sys.argv[2], optimize=True)
sys.stdout.write(f"{sys.argv[2]}: {Path(sys.argv[2]).stat().st_size // 1000} kB\n")
