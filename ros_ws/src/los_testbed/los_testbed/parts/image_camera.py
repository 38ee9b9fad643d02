"""The telescope with a camera that takes images of a guide star: frames in, two angles out.

At tick k with a frame the angles are those of the exposure from tick k - d - E to tick k - d, with the read-out delay d
and the exposure E: the frame is made of the line of sight at these E + 1 ticks, straight between them, and read out at
tick k - d; its centroid takes the place of the measurement of the camera at tick k. **The window follows the star in
whole pixels**: its middle is the pixel of the last angles. After `SEARCH_AFTER` frames in a row without angles the star
is searched in the whole field, which puts the window at the pixel of its true mean place.

Frame and centroid take longer than a tick of the telescope. **`after` defers them until the angles are due**; `work`
computes one of them between two ticks. The result depends only on the data stored by `after`, not on when it is
computed.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lftkit.arrays import FloatArray
from titop_plant.interface import CAMERA, DT, TRUTH

if TYPE_CHECKING:
    from pointing_analysis.image.centroid import Centroid
    from pointing_analysis.image.star_camera import StarCamera

SEARCH_AFTER = 5
"""Frames in a row without angles after which the star is searched in the whole field."""
DROPPED, BEFORE_START = "dropped", "before_start"
"""Frames without angles beside those of the centroid: lost on the way; exposed before the run began."""
SEED_KEY = 17
"""Of the camera's random numbers among those of a run: the other noise of the loop stays as it is."""


@dataclass
class _Frame:
    """An exposure: the tick at which its angles are there, the middle of its window, the path about it [rad].

    Counts and place are None until they are made; `noisy` is whether the counts have noise.
    """

    due: int
    middle: FloatArray
    path: FloatArray
    noisy: bool
    counts: FloatArray | None = None
    found: Centroid | None = None


class ImageCamera:
    """A camera that takes images, a part of :class:`titop_plant.simulation.plant.Plant`.

    The plant's own measurement of the camera only says which frames are dropped.

    Parameters
    ----------
    camera : StarCamera
    frame_ticks : int
        Ticks from one frame to the next.
    seed : int
        Of the run.
    noise : bool
        Whether frames have noise and cosmic hits.
    """

    def __init__(self, camera: StarCamera, frame_ticks: int, seed: int, noise: bool) -> None:
        from pointing_analysis.image.centroid import centroid  # scipy, which a vector camera does without

        self.camera, self.frame_ticks, self._find = camera, frame_ticks, centroid
        self._exposure = round(camera.camera.exposure / DT)
        self._delay = round(camera.camera.readout_delay / DT)
        self._seed, self._with_noise = seed, noise
        self._path = np.zeros((self._exposure + 1, TRUTH))
        self.image = np.zeros((camera.camera.window, camera.camera.window))
        """Counts of the frame of the last tick with one."""
        self.reset()

    def reset(self) -> None:
        """Return to tick 0: same seed, bit-identical frames."""
        self._rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(SEED_KEY,)))
        self._noisy = self._with_noise
        self.tick = 0
        self.frames = 0
        self.missing: dict[str, int] = {}
        self._without = SEARCH_AFTER  # nothing is known yet: the first frame is a search
        self._middle: FloatArray = np.zeros(TRUTH)
        self._read: deque[_Frame] = deque()
        self.image[:] = 0.0

    def change(self, name: str, value: float) -> None:
        """Change ``noise`` of the frames, see `Plant.change`; other names have no effect."""
        if name == "noise":
            self._noisy = bool(value)

    def after(self, measurement: FloatArray, truth: FloatArray) -> None:
        """Replace the camera's angles of this tick in `measurement` (22,) [rad]; `truth` (2,) is the line of sight."""
        self._path[:-1] = self._path[1:]
        self._path[-1] = truth
        if (self.tick + self._delay) % self.frame_ticks == 0 and self.tick >= self._exposure:
            self._expose()
        if self.tick % self.frame_ticks == 0:
            measurement[CAMERA] = self._angles(bool(np.isnan(measurement[CAMERA]).any()))
        self.tick += 1

    def work(self) -> None:
        """Do a part of the work on frames that are not finished; all of it where the angles are due at the next tick.

        Between two ticks, in the thread that steps.
        """
        more = self._go_on()
        while more and self._read[0].due <= self.tick and self._read[0].found is None:
            more = self._go_on()

    def _go_on(self) -> bool:
        """Make the next frame or locate the star in it; whether there was work to do."""
        for frame in self._read:  # random numbers are taken in the order of the frames
            if frame.counts is None:
                expected = self.camera.expected(frame.path)
                frame.counts = self.camera.read_out(expected, self._rng if frame.noisy else None)
                return True
            if frame.found is None:
                frame.found = self._find(frame.counts, self.camera)
                return True
        return False

    def _expose(self) -> None:
        """Keep the exposure that ends at this tick."""
        pixel, mean = self.camera.optics.pixel, self._path.mean(axis=0)
        if not np.isfinite(mean).all():
            return
        if self._without >= SEARCH_AFTER:
            self._middle = pixel * np.rint(mean / pixel)
        self._read.append(_Frame(self.tick + self._delay, self._middle, self._path - self._middle, self._noisy))

    def _angles(self, dropped: bool) -> FloatArray:
        """Angles of the frame due at this tick [rad], NaN if it has none."""
        pixel = self.camera.optics.pixel
        self.frames += 1
        if not self._read or self._read[0].due != self.tick:
            return self._none(BEFORE_START)
        frame = self._read[0]
        while frame.found is None:
            self._go_on()
        counts, stars = frame.counts, frame.found
        assert counts is not None and stars is not None
        self._read.popleft()
        self.image[:] = counts
        if dropped:
            return self._none(DROPPED)
        if stars.reason:
            self._without += 1
            return self._none(stars.reason)
        angles = frame.middle + stars.place
        self._without, self._middle = 0, pixel * np.rint(angles / pixel)
        return np.asarray(angles)

    def _none(self, reason: str) -> FloatArray:
        self.missing[reason] = self.missing.get(reason, 0) + 1
        return np.full(TRUTH, np.nan)

    @property
    def counts(self) -> dict[str, str]:
        """Frames of the run so far, and those without angles by reason, for its statistics."""
        missing = {f"frames_{reason}": str(count) for reason, count in sorted(self.missing.items())}
        return {"frames": str(self.frames), **missing}


def image_camera_of(plant: object) -> ImageCamera | None:
    """The camera of a plant that takes images; None for another camera."""
    camera = getattr(plant, "camera", None)
    return camera if isinstance(camera, ImageCamera) else None


def frame_counts(plant: object) -> dict[str, str]:
    """:attr:`ImageCamera.counts` of a plant; nothing for a camera without images."""
    camera = image_camera_of(plant)
    return {} if camera is None else camera.counts


def window_of(plant: object) -> int:
    """Pixels along each axis of the images of a plant; 0 for a camera without images."""
    camera = image_camera_of(plant)
    return 0 if camera is None else camera.camera.camera.window


__all__ = ["ImageCamera", "frame_counts", "image_camera_of", "window_of"]
