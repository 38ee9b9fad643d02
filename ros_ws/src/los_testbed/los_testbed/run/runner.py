"""Start the four nodes as processes, watch them, end them in the right order, collect their results."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from los_testbed.bags.writer import check_new_bag
from los_testbed.config.run_config import RunConfig
from los_testbed.config.topics import NODES
from los_testbed.parts.device_contract import NOT_ZERO
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.start import START_VARIABLE, for_nodes
from los_testbed.run.bag_names import free_name, recorded
from los_testbed.run.loop.members import MEMBERS_VARIABLE, complete_line
from los_testbed.run.loop.slow_sensor import frames_in_words
from los_testbed.run.processes.answer_watch import TICKS, AnswerWatch
from los_testbed.run.processes.domains import domain_lock, output_lock
from los_testbed.run.processes.memory import check_address_space
from los_testbed.run.processes.memory_file import MemoryFile, memory_file
from los_testbed.run.processes.node_launch import (
    STATISTICS_VARIABLE,
    check_ros,
    environment,
    module_of,
    node_command,
    parameter_text,
    programs,
    ros_arguments,
)
from los_testbed.run.processes.node_process import NodeProcess
from los_testbed.run.processes.ros_variables import domain_of
from los_testbed.run.processes.viewers import LIVE, Live
from los_testbed.run.results import Exercised, Results, RunError, counted, late_reports
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.read.run_end import FAILURE
from titop_plant.interface import RATE

LAWS = ("estimator", "controller")

RESTARTS = 3
"""Restarts of a node that dies during the run."""

STOP_S = 10.0
ENDED = "ended"
"""Note about a node that was shut down cleanly by another program's signal."""

REMIND_S = 5.0
"""Time after which a node is signalled again: a signal during its start may be lost."""


class RunEndedError(RuntimeError):
    """The run has to end: nodes do not respond, its ticks have stopped, or a law of a loop on a device has died."""


class Runner:
    """One run with processes.

    Parameters
    ----------
    config : RunConfig
        The run; its `output` is the folder of the bag.
    progress : callable
        Called with the number of ticks done.
    commands : mapping, optional
        Commands for nodes that are not the package's own (another plant, another controller).
    live : Live, optional
        Server for viewers; default: none.
    lock_domain : bool
        Refuse another run on the domain and namespace; False where the caller holds them.
    tell : callable
        Called with a line about each event during the run.
    """

    def __init__(
        self,
        config: RunConfig,
        progress: Callable[[int], None] = lambda ticks: None,
        commands: Mapping[str, Sequence[str]] | None = None,
        live: Live | None = None,
        lock_domain: bool = True,
        tell: Callable[[str], None] = lambda line: None,
    ) -> None:
        self._tell = tell
        self._watch = AnswerWatch()
        self._not_answering: list[str] = []
        self._live = live
        self._lock_domain = lock_domain
        self._config = config.at_rest() if commands and "plant" in commands else config
        self._progress = progress
        self._programs = programs(config.processes, usual=not commands)
        usual = {name: node_command(module_of(name, config.device)) for name in self._programs}
        self._commands = {name: (commands or {}).get(name, usual[name]) for name in self._programs}
        self._nodes: dict[str, NodeProcess] = {}
        self._selector = selectors.DefaultSelector()
        self._seen: dict[tuple[str, str], dict[str, Any]] = {}
        self._errors: list[tuple[str, str]] = []
        self._replaced: dict[str, int] = {}
        self._closed_by_recorder: list[Path] = []
        self._resets = 0
        self._ticks_done = 0
        self._before = 0
        self._lost_device = ""
        self._parameters: MemoryFile | None = None
        self._start_file: MemoryFile | None = None
        self._statistics: MemoryFile | None = None
        self._members: MemoryFile | None = None
        self._variables: Mapping[str, str] = {}
        self.results = Results()

    @property
    def processes(self) -> dict[str, int]:
        """Process numbers of the nodes that run."""
        return {name: program.process.pid for program in self._nodes.values() for name in program.nodes}

    @property
    def ticks_done(self) -> int:
        """Ticks done as reported by the plant, those before a restart included."""
        return self._ticks_done

    @property
    def domain(self) -> int:
        """ROS domain of the run."""
        domain = self._config.domain
        return domain if domain is not None else domain_of(os.environ)

    def run(self) -> Results:
        """Start, watch and end the nodes.

        Raises
        ------
        ValueError
            A user error detected before anything is started.
        RunError
            A node failed; the others were ended.
        """
        check_ros(self._config.domain)
        check_address_space(self._live is not None)
        check_new_bag(self._config.bag)
        parts = RunParts(self._config)
        self._config = parts.config  # with the scenario that acts, so that the nodes know the start as theirs
        self.results.warnings += parts.check()
        text = parameter_text(self._config).encode()
        start = for_nodes(self._config.to_plain(), parts.start)
        with (
            domain_lock(self.domain, self._config.namespace) if self._lock_domain else contextlib.nullcontext(),
            output_lock(self._config.bag),
            memory_file(text, "run.yaml") as self._parameters,
            memory_file(start, "start.json") as self._start_file,
            memory_file(b"", "statistics.json") as self._statistics,
            memory_file(self._unlisted().encode(), "members") as self._members,
        ):
            self._variables = {
                **environment(self._config.domain),
                START_VARIABLE: self._start_file.path,
                STATISTICS_VARIABLE: self._statistics.path,
                MEMBERS_VARIABLE: self._members.path,
            }
            if self._live is not None:
                self._commands[LIVE] = [*node_command(LIVE), *self._live.arguments()]
            try:
                try:
                    self._perform()
                except RunError as error:
                    causes = "; ".join(dict.fromkeys([*self.results.failures, str(error)]))
                    plant = {**self.results.statistics.get("plant", {}), FAILURE: causes}
                    self._give_to_recorder({**self.results.statistics, "plant": plant})
                    raise
                finally:
                    self._end_all()  # the recorder writes what it has when it ends
            except RunError as error:
                raise RunError(f"{causes}{recorded(self._config.bag)}", error.code) from None
        return self.results

    def _unlisted(self) -> str:
        """Beginning of the list of members: programs of the user's own in a node's place may list nothing."""
        space = self._config.namespace.rstrip("/")
        by_user = [name for name in LAWS if name in self._commands and self._commands[name] != node_command(name)]
        return "".join(complete_line(f"{space}/{name}") for name in by_user)

    def _perform(self) -> None:
        try:
            self._start("plant")
            if self._live is not None:
                self._start(LIVE)
                self._until(LIVE, "ready", 120.0)
            self._until("plant", "alone", self._config.start_timeout + 30.0)
            for name in list(self._programs)[1:]:
                self._start(name)
            most = None if self._config.wait_for_start else self._config.start_timeout + 120.0
            self._until("plant", "running", most, or_kind="too_slow")
            if slow := self._seen.get(("plant", "too_slow")):
                self.results.too_slow = Exercised(slow["ticks"], slow["late"], slow["lost"], slow["median_us"])
                return
            self._until("plant", "done", None)
        except RunEndedError as error:
            self.results.failures.append(str(error))
            self._end_ticks()
        except KeyboardInterrupt:
            self.results.interrupted = True
            self._accept_ends()
            if ("plant", "running") not in self._seen:
                return
            self._end_ticks()
        self._finish()
        if self._lost_device:
            raise RunError(self._lost_device, ExitCode.DEVICE)

    def _end_ticks(self) -> None:
        """End a run early; a suspended node is resumed to end."""
        self._not_answering = [name for name in self._watch.silent() if name in self._nodes]
        for name in self._not_answering:
            self._nodes[name].process.send_signal(signal.SIGCONT)
        self._nodes["plant"].interrupt()
        self._ends_in_order("plant")

    def _ends_in_order(self, name: str, bag: Path | None = None) -> None:
        """Wait for a node to finish; after a timeout it is killed, and the bag stays as it is."""
        try:
            self._until(name, "done", STOP_S)
        except RunError as error:
            if self._nodes[name].process.poll() is not None:
                raise
            if name == "plant" and self._config.device:
                self._lost_device = f"{error}; {NOT_ZERO}: its driver was ended"
            self.results.failures.append(self._lost_device or str(error))
            self._nodes[name].process.kill()
            self._seen[name, "done"] = {"statistics": {}, "bag": None if bag is None else str(bag)}

    def _accept_ends(self) -> None:
        """End of the run: nodes that a signal ended early have done their work."""
        for node in self._nodes.values():
            for name in node.nodes:
                if (name, ENDED) in self._seen:
                    self._seen[name, "done"] = self._seen.pop((name, ENDED))
                    node.asked_to_stop = True

    def _finish(self) -> None:
        """Followers first, so that their last samples reach the recorder; then the recorder.

        It gets the nodes' last statistics from here: on a busy machine reports may be lost.
        """
        served = [LIVE] if LIVE in self._nodes else []
        laws = [name for name in self._programs if name not in ("plant", "recorder")]
        for name in (*laws, *served):
            self._nodes[name].interrupt()
        self._await_exit(("plant", *laws))
        for name in (name for name in self._not_answering if name != "recorder"):
            self._nodes[name].process.kill()
        for name in NODES[:-1]:
            self.results.statistics[name] = self._seen.get((name, "done"), {}).get("statistics", {})
        self._give_to_recorder(self.results.statistics)
        if self._replaced.get("recorder") and ("recorder", "ready") not in self._seen:
            raise RunError("the run ended before another recorder was ready")
        self._nodes["recorder"].interrupt()
        if "recorder" in self._not_answering:
            self._ends_in_order("recorder", self._config.bag if self._config.bag.is_dir() else None)
        else:
            self._until("recorder", "done", 60.0)
        self._await_exit(("recorder", *served))
        self.results.statistics["recorder"] = self._seen[("recorder", "done")]["statistics"]
        self._tell_counts()
        histogram = self._seen.get(("plant", "done"), {}).get("latency", {})
        self.results.latency = {int(cell): int(count) for cell, count in histogram.items()}
        bag = self._seen[("recorder", "done")].get("bag")
        bags = [*self.results.earlier, *([Path(bag)] if bag else self._closed_by_recorder)]
        if not bags and not self.results.interrupted:
            messages = [message for who, message in self._errors if who == "recorder"]
            there = "" if self._replaced.get("recorder") else "; there is no bag"
            raise RunError(f"recorder: {[*messages, 'no message received'][0]}{there}")
        self.results.bag = bags[-1] if bags else None
        restarted = len(bags) - 1 > self._resets
        lines = self.results.failures if restarted else self.results.warnings
        what = "the restart of the plant" if restarted else "the reset"
        lines += [f"the part before {what} is in {path}" for path in bags[:-1]]

    def _tell_counts(self) -> None:
        """Report messages of second publishers, those of them that were used, and late reports."""
        self.results.warnings += late_reports(self.results.statistics.get("recorder", {}))
        self.results.warnings += frames_in_words(self.results.statistics.get("estimator", {}))
        foreign, misused = (counted(self.results.statistics, kind) for kind in ("foreign_", "misused_"))
        for topic, count in foreign.items():
            if topic not in misused:
                self.results.warnings.append(f"{topic}: {count} messages of second publishers were not used")
        for topic, count in misused.items():
            kept = [text for text in self.results.failures if not text.startswith(f"{topic} had a second publisher")]
            what = f"{topic} had a second publisher: {count} of its messages were used while the node was silent"
            self.results.failures[:] = [*kept, what]

    def _start(self, name: str) -> None:
        shared = [self._parameters, self._start_file, self._statistics, self._members]
        assert self._parameters is not None
        command = [*self._commands[name], *ros_arguments(self._config.namespace, self._parameters.path)]
        if name == "recorder" and self._config.bag.exists():  # what the first one wrote is left alone
            command += ["-p", f"output:={free_name(self._config.bag)}"]
        if name == "plant" and self._before:  # the run ends when it was to end
            command += ["-p", f"duration:={(self._config.ticks - self._before) / RATE:.3f}"]
        files = [file.descriptor for file in shared if file is not None]
        nodes = self._programs.get(name, (name,))
        node = self._nodes[name] = NodeProcess(name, command, self._variables, files, nodes)
        for stream in node.streams:
            os.set_blocking(stream.fileno(), False)
            self._selector.register(stream, selectors.EVENT_READ, node)

    def _until(self, name: str, kind: str, timeout: float | None, or_kind: str = "") -> None:
        """Watch all nodes until this one reports this event, or the other; an ending one is signalled again."""
        end = None if timeout is None else time.monotonic() + timeout
        remind = time.monotonic() + REMIND_S
        while (name, kind) not in self._seen and (name, or_kind) not in self._seen:
            self._poll(0.1)
            if (name, or_kind) in self._seen:
                return
            self._check()
            self._check_answers()
            self._check_awaited(name, kind)
            if end is not None and time.monotonic() > end:
                raise RunError(f"{name} did not reach {kind!r} within {timeout:g} s{_load()}")
            if self._nodes[name].asked_to_stop and time.monotonic() > remind:
                remind = time.monotonic() + REMIND_S
                self._nodes[name].interrupt()

    def _check_awaited(self, name: str, kind: str) -> None:
        """Raise if the node waited for has ended, also on request."""
        node = self._nodes[name]
        code = node.process.poll()
        in_order = node.asked_to_stop or (name, "done") in self._seen
        if code is None or not in_order:  # ended after the last look: `_check` sees it next
            return
        self._poll(0.1)
        if (name, kind) not in self._seen:
            messages = [message for who, message in self._errors if who == name]
            raise RunError(f"{name}: {messages[-1]}" if messages else node.how_it_ended(code))

    def _check_answers(self) -> None:
        """Report silent nodes; raise if one is silent too long, unless the run is ending."""
        if self._nodes["plant"].asked_to_stop or ("plant", "done") in self._seen:
            return
        for line in self._watch.look():
            self._tell(line)
        if hung := self._watch.silent(self._config.hang_timeout):
            raise RunEndedError(f"{self._watch.in_words(hung)}: the run was ended (--hang-timeout)")

    def _hear(self, name: str) -> None:
        """An event of a program, or a tick."""
        if (line := self._watch.heard(name)) and not self._not_answering:  # those are woken to their end
            self._tell(line)
            self.results.warnings.append(line)

    def _poll(self, timeout: float) -> None:
        for key, _ in self._selector.select(timeout):
            node: NodeProcess = key.data
            data = os.read(key.fd, 65536)
            if not data:
                self._selector.unregister(key.fileobj)
            elif key.fileobj is node.streams[1]:
                node.errors = (node.errors + data.decode(errors="replace"))[-4000:]
            else:
                for event in node.feed(data):
                    if self._watch.knows(node.name):
                        self._hear(node.name)
                    origin = str(event.get("node", node.name))
                    self._handle(origin if origin in node.nodes else node.name, event, node)

    def _may_end(self, node: NodeProcess) -> bool:
        """Whether a signal to a node is a clean shutdown."""
        return node.asked_to_stop or self.results.interrupted or ("plant", "done") in self._seen

    def _handle(self, name: str, event: dict[str, Any], node: NodeProcess) -> None:
        """Note an event of a node of this program."""
        kind = str(event["event"])
        if kind == "done" and event.get("signal") and not self._may_end(node):
            kind = ENDED
            if event.get("bag"):
                self._closed_by_recorder = [Path(event["bag"])]
        if kind in ("done", ENDED):
            self._watch.forget(node.name)
        if kind == "alive" and name != LIVE:
            self._hear(node.name)
            if name == "plant":
                self._watch.waits_for(event.get("waits_for", ()))
        if "tick" in event:
            self._hear(TICKS)
            self._ticks_done = self._before + int(event["tick"])
            self._progress(self._ticks_done)
        elif kind == "running":
            self._hear(TICKS)
        elif kind == "warning":
            message = str(event["message"])
            if message not in self.results.warnings:
                self.results.warnings.append(message)
        elif kind == "second_publisher":
            message = f"{event['topic']} had a second publisher (node {event['publisher']}): its messages were not used"
            if message not in self.results.failures:
                self.results.failures.append(message)
        elif kind == "reset":
            self._watch.forget(TICKS)
            self._resets += 1
            self._ticks_done = self._before
        elif kind == "live" and self._live is not None:
            self._live.tell(str(event["foxglove"]), str(event["page"]))
        elif kind == "bag":
            self.results.earlier.append(Path(event["path"]))
        elif kind == "left":
            self._go_on_without(name)
        elif kind == "error":
            self._errors.append((name, str(event["message"])))
        self._seen[(name, kind)] = event

    def _check(self) -> None:
        """Raise if a node ended without request."""
        for node in list(self._nodes.values()):
            code = node.process.poll()
            if code is None or node.asked_to_stop:
                continue
            self._poll(0.1)
            if ("plant", "done") in self._seen:
                self._accept_ends()
            if code == 0 and all((name, "done") in self._seen for name in node.nodes):
                if ("plant", "running") not in self._seen:
                    raise RunError(f"{node.name} was ended before the run began")
                for name in node.nodes if ("plant", "done") not in self._seen else ():
                    self._go_on_without(name)
                continue
            messages = [message for name, message in self._errors if name in node.nodes]
            ended = [self._seen[name, ENDED] for name in node.nodes if (name, ENDED) in self._seen]
            if node.name == LIVE and (LIVE, "ready") in self._seen:  # the run continues without it
                node.asked_to_stop = True
                how = [f"code {code}", *messages][-1]
                self.results.warnings.append(f"the server for viewers ended unexpectedly: {how}")
                continue
            if messages and not ended:
                # the plant refuses publishers until it runs
                working = "running" if node.name == "plant" else "ready"
                before_work = not any((name, working) in self._seen for name in node.nodes)
                before_work = before_work and ("plant", "running") not in self._seen
                known = code == ExitCode.DEVICE or (code == ExitCode.USER_ERROR and before_work)
                raise RunError(f"{node.name}: {messages[-1]}", code if known else 1)
            number = max([0, *(int(event.get("signal", 0)) for event in ended)])
            self._replace(node, node.how_it_ended(code, number), code < 0 or number > 0)
            return

    def _go_on_without(self, name: str) -> None:
        """A life-cycle request has ended a node: in real time the actuators fade to zero."""
        what = f"{name} was shut down by a life-cycle request (from an unknown node)"
        if self._config.mode == "lockstep":  # the tick that waits for it can no longer be answered
            raise RunError(f"{what}: a run in lockstep cannot continue without it")
        line = f"{what}; the run continued without it"
        if line not in self.results.warnings:
            self.results.warnings.append(line)

    def _replace(self, node: NodeProcess, what: str, killed: bool) -> None:
        """Restart the node while the others continue, or fail after too many restarts.

        On a device no loop is closed again: without its driver or a law the run ends.

        Before the run begins, a node ended by a signal loses nothing, unless it is the plant. A plant restarts from its
        initial state: estimator and controller are reset with it when it holds, the recorder closes its bag and begins
        another, and the run ends at its planned time.
        """
        # in lockstep the current tick waits for the node's command, which is lost
        running = ("plant", "running") in self._seen
        if self._config.device and node.name == "plant":
            raise RunError(f"{what}; {NOT_ZERO}: its driver has ended", ExitCode.DEVICE)
        if self._config.device and running and node.name != "recorder":
            node.asked_to_stop = True
            raise RunEndedError(f"{what}: the run was ended")
        possible = self._config.mode == "realtime" if running else killed and node.name in list(self._programs)[1:]
        rest = self._config.ticks - self._ticks_done
        if not possible or sum(self._replaced.values()) >= RESTARTS or (node.name == "plant" and rest < 1):
            raise RunError(what)
        self._replaced[node.name] = self._replaced.get(node.name, 0) + 1
        self._watch.forget(node.name)
        if node.name == "plant":
            self._before = self._ticks_done
            self._watch.forget(TICKS)
        if running:
            self.results.failures.append(f"{what}; it was restarted{self._left_by(node)}")
        else:
            self.results.warnings.append(f"{what}; it was restarted before the run began")
        for stream in node.streams:
            with contextlib.suppress(KeyError):
                self._selector.unregister(stream)
            stream.close()
        for name in node.nodes:
            for kind in ("done", "ready", ENDED):
                self._seen.pop((name, kind), None)
        self._start(node.name)

    def _left_by(self, node: NodeProcess) -> str:
        """Record of a recorder that ended unexpectedly."""
        if ("recorder", ENDED) in self._seen and node.name == "recorder":
            return "".join(f"; recorded until then: {path}" for path in self._closed_by_recorder)
        last = [path for path in (self._config.bag, *self.results.earlier) if path.is_dir()][-1:]
        if node.name != "recorder" or not last:
            return ""
        return f"; recorded until then: {last[0]}: los-testbed bag repair {last[0]}"

    def _give_to_recorder(self, statistics: Mapping[str, Mapping[str, str]]) -> None:
        """Last statistics of the nodes, in place of those that were there, for the end of the bag."""
        assert self._statistics is not None
        os.ftruncate(self._statistics.descriptor, 0)
        os.pwrite(self._statistics.descriptor, json.dumps(statistics).encode(), 0)

    def _await_exit(self, names: Sequence[str]) -> None:
        end = time.monotonic() + STOP_S
        while any(self._nodes[name].process.poll() is None for name in names) and time.monotonic() < end:
            self._poll(0.02)
        self._poll(0.02)

    def _end_all(self) -> None:
        """End all processes that still run."""
        alive = [node for node in self._nodes.values() if node.process.poll() is None]
        for node in alive:
            node.interrupt()
        end = time.monotonic() + STOP_S
        for node in alive:
            while node.process.poll() is None:
                if time.monotonic() > end:
                    node.process.kill()
                    node.process.wait()
                    if node.name == "plant" and self._config.device:
                        self._tell(f"{NOT_ZERO}: the driver of {self._config.device} did not end")
                time.sleep(0.01)
        for node in self._nodes.values():
            for stream in node.streams:
                stream.close()
        self._selector.close()


def _load() -> str:
    """Cause of a delay: a busy machine."""
    load, processors = os.getloadavg()[0], os.cpu_count() or 1
    return f" (load average {load:.1f} on {processors} processors)" if load > 2 * processors else ""
