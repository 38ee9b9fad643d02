"""A run in one process, without ROS, recorded in a bag as that of the nodes."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from lftkit.support.threads import one_thread
from los_testbed.bags.cdr import codec_for
from los_testbed.bags.writer import BagWriter
from los_testbed.config.run_config import RunConfig
from los_testbed.config.topics import TOPICS, TopicDefinition
from los_testbed.parts.image_camera import frame_counts
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.start import AT_REST
from los_testbed.parts.stepped_plant import SteppedPlant, plant_notes
from los_testbed.run.identity import DIGEST, announced
from los_testbed.run.loop.closed_loop import SampleBlock, SimulatedLoop
from los_testbed.run.loop.contract import check_plant
from los_testbed.run.metadata import METADATA_NAME, attachments, final_metadata, run_metadata
from pointing_analysis.read.run_end import FAILURE
from titop_plant.interface import TICK_NS


class BagSink:
    """Writes blocks into a bag; log and publishing times are the stamps."""

    def __init__(self, bag: BagWriter, ticks: Mapping[str, int], topics: Sequence[TopicDefinition] = TOPICS) -> None:
        self._bag = bag
        self._codecs = [(topic, codec_for(topic), topic.every(ticks) * TICK_NS) for topic in topics]

    def __call__(self, block: SampleBlock, rows: int) -> None:
        """Write the first `rows` ticks of the block as one chunk."""
        stamps = block.stamps[:rows]
        for topic, codec, period in self._codecs:
            values = getattr(block, topic.vector)[:rows, topic.columns]
            times = stamps
            if period > TICK_NS:
                due = stamps % period == 0
                values, times = values[due], stamps[due]
            self._bag.write(topic.path_in(self._bag.namespace), times, times, codec.encode_many(times, values))
        self._bag.end_chunk()


def run_in_process(
    config: RunConfig,
    bag_path: Path,
    plant: SteppedPlant | None = None,
    progress: Callable[[int], None] = lambda ticks: None,
) -> dict[str, dict[str, str]]:
    """Simulate and record a run; returns the statistics as the bag holds them.

    Parameters
    ----------
    config : RunConfig
        The run; its mode is ignored.
    bag_path : Path
        Folder to make.
    plant : SteppedPlant, optional
        Another plant than the one of the configuration. It starts where it is, the controllers at rest.
    progress : callable
        Called with the number of ticks done, once per block.

    Raises
    ------
    ValueError
        A controller that cannot be used, a bag that exists.
    LoopDivergedError
        The controllers do not stabilise the plant; the bag holds the run up to there.
    RunFailedError
        Plant, observer or controller raised an exception; the bag holds the run up to there and says so, and there is
        none if it failed at the first tick.
    """
    if plant is None:
        return record(RunParts(config), bag_path, progress)
    parts = RunParts(config.at_rest())
    check_plant(plant, parts.ports.used_by())
    return record(parts, bag_path, progress, plant)


def record(
    parts: RunParts,
    bag_path: Path,
    progress: Callable[[int], None] = lambda ticks: None,
    user_plant: SteppedPlant | None = None,
) -> dict[str, dict[str, str]]:
    """Simulate and record the parts of a run, as :func:`run_in_process`; `user_plant` replaces the plant of `parts`."""
    loop = SimulatedLoop.of(parts, user_plant)
    plant, start, name = loop.plant, AT_REST, {}
    if user_plant is None:
        start = parts.start
    else:
        name = {"plant": parts.config.plant or f"{type(user_plant).__module__}:{type(user_plant).__qualname__}"}
    digests = {node: {DIGEST: text} for node, text in announced(parts).items() if text}
    counts = {"ticks": "0", "missed_ticks": "0", **plant_notes(plant), **name}
    statistics = {**digests, "plant": counts if user_plant is not None else {**digests.get("plant", {}), **counts}}
    topics = parts.topics if user_plant is None else TOPICS
    bag = BagWriter(
        bag_path,
        {METADATA_NAME: run_metadata(parts, start, statistics)},
        attachments(parts, start),
        topics=topics,
    )
    sink, done = BagSink(bag, parts.ports.with_frames(plant.frame_ticks).ticks, topics), 0

    def write(block: SampleBlock, rows: int) -> None:
        nonlocal done
        sink(block, rows)
        done += rows
        progress(done)

    try:
        with one_thread():
            loop.run(parts.config.ticks, write)
    except Exception as error:  # one that was interrupted ends early, and has not failed
        statistics["plant"][FAILURE] = str(error) or type(error).__name__
        raise
    finally:
        messages = bag.counts().values()
        statistics["plant"] |= {"ticks": str(max(messages, default=0)), **frame_counts(plant)}
        statistics["recorder"] = {"samples_lost": "0", "messages": str(sum(messages))}
        # Complete the bag; without a tick in it, it is removed
        metadata = {METADATA_NAME: final_metadata(parts, statistics, start)}
        try:
            bag.close(metadata)
        except OSError as error:  # the disk is full
            if done:
                advice = f"`los-testbed bag repair {bag.path}` makes a bag of the written data"
                raise OSError(error.errno, f"{error.strerror}; {advice}", error.filename) from None
            raise
        finally:
            if not done:
                shutil.rmtree(bag.path, ignore_errors=True)
    return statistics
