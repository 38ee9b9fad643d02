"""Guide-star magnitude and frame rate against pointing: runs of the loop with images of the star.

python examples/guide_star_trade.py [--magnitudes 12,15] [--rates 50,25] [--duration 20] [--design] [--output trade]

For each star and rate a folder has the parameter file, the designs, where `--design` asks for some (some minutes each),
and the bag; what a folder has is not made again.
"""

import argparse
import tempfile
from pathlib import Path

import tomli_w
from los_testbed import api

from los_design.redesign import design_all
from los_design.synthesis.options import DesignOptions
from pointing_analysis.files.structured_text import load_toml, read_text
from titop_plant.telescope.load import load_telescope

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--magnitudes", default="12,15")
parser.add_argument("--rates", default="50,25", help="frames per second; the exposure is the time between them")
parser.add_argument("--duration", type=float, default=2.0, help="[s]")
parser.add_argument("--parameters", type=Path, help="file of your telescope; files that it names have whole paths")
parser.add_argument("--design", action="store_true", help="design controllers for each star and rate")
parser.add_argument("--output", type=Path)
asked = parser.parse_args()

own = load_toml(read_text(asked.parameters), asked.parameters) if asked.parameters else {"base": "reference"}
with tempfile.TemporaryDirectory() as scratch:
    print("magnitude  frames/s  without angles  APE [arcsec]  RPE [mas]     MTF  Strehl")
    for rate in map(float, asked.rates.split(",")):
        for magnitude in map(float, asked.magnitudes.split(",")):
            folder = (asked.output or Path(scratch)) / f"magnitude-{magnitude:g}-rate-{rate:g}"
            folder.mkdir(parents=True, exist_ok=True)
            star = {"magnitude": magnitude, "exposure": round(1.0 / rate, 9)}
            changed = {"sensors": {**own.get("sensors", {}), "camera": "image", "camera_rate": rate}}
            changed["camera"] = {**own.get("camera", {}), **star}
            file, bag = folder / "telescope.toml", folder / "bag"
            file.write_text(tomli_w.dumps({**own, **changed}), "utf-8")
            settings = {"parameters": file, "duration": asked.duration}
            if asked.design:
                design_all(load_telescope(file), folder / "designs", DesignOptions(short=True))
                settings["designs"] = folder / "designs"
            found = api.analyse(bag) if bag.exists() else api.run(bag, **settings)
            s, lost = found.summary, found.summary.camera_dropped
            image = (s.image.mtf, s.image.strehl) if s.image else (float("nan"), float("nan"))
            cells = f"{s.ape_quantile:12.3g}  {s.rpe_windows_quantile:9.3g}  {image[0]:6.3g}  {image[1]:6.3g}"
            print(f"{magnitude:9g}  {rate:8g}  {lost:14d}  {cells}")
