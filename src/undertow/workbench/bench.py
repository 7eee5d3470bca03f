"""The workbench behind its windows: one session, its logs in memory, and a process that does long work."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import socket
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from undertow.errors import UndertowError
from undertow.identification.logs.run import Run
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Vehicle

from .session import LogChoice, LogSegment, ModelStep, Remedy, Role, Session, Workspace
from .tasks import TASKS, Job, read_all

INSTALL = 'pip install "undertow[workbench]"'
HOST = "127.0.0.1"
Message = dict[str, Any]


def require_nicegui() -> None:
    """Refuse to begin without the library."""
    if find_spec("nicegui") is None:
        raise UndertowError(f"the workbench needs NiceGUI, which is not installed: {INSTALL}")


def require_port(port: int) -> None:
    """Refuse a port that somebody else has."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise UndertowError(f"port {port} is taken: choose another one with --port") from error


@dataclass
class Work:
    """A task that is being done: how much of it, and what now."""

    task: str
    key: str
    done: float = 0.0
    words: str = ""


class Worker:
    """A process that does one task at a time.

    `finished` is told, in a thread, what came of it, and then sets `work` to None: until that is taken over,
    no other task may begin.
    """

    def __init__(self, finished: Callable[[Work, Message], None]) -> None:
        self._finished = finished
        self._pipe: Connection | None = None
        self._process: Any = None
        self.work: Work | None = None

    def start(self, place: Workspace, task: str, args: Message) -> None:
        """Begin a task."""
        if self.work is not None:
            raise UndertowError(f"'{TASKS[self.work.task][1]}' is still running: wait, or cancel it")
        pipe = self._connected()
        self.work = Work(task, place.key, words=TASKS[task][1])
        session = place.session.model_dump(by_alias=True)
        order = {"task": task, "args": args, "folder": str(place.folder), "session": session}
        pipe.send_bytes(json.dumps(order).encode())
        threading.Thread(target=self._listen, args=(pipe, self.work), daemon=True).start()

    def cancel(self) -> None:
        """Give up what is being done; nothing of it is kept."""
        self.work = None
        self.close()

    def close(self) -> None:
        """End the process and whatever it started."""
        process, self._process, self._pipe = self._process, None, None
        if process is None or not process.is_alive():
            return
        with suppress(ProcessLookupError, PermissionError):
            if hasattr(os, "killpg") and os.getpgid(process.pid) == process.pid:
                os.killpg(process.pid, signal.SIGTERM)  # its helpers, too
        process.terminate()
        process.join()

    def _connected(self) -> Connection:
        if self._process is None or not self._process.is_alive() or self._pipe is None:
            context = multiprocessing.get_context("spawn")
            self._pipe, theirs = context.Pipe()
            self._process = context.Process(target=serve, args=(theirs,), name="undertow-workbench")
            self._process.start()
            theirs.close()
        return self._pipe

    def _listen(self, pipe: Connection, work: Work) -> None:
        """Take messages until the task is over; those of a task that was cancelled are dropped."""
        message: Message = {"failed": "the worker process has ended (out of memory?): try again"}
        with suppress(EOFError, OSError):
            while "progress" in (message := json.loads(pipe.recv_bytes())):
                work.done, work.words = message["progress"], message["words"]
        if self.work is work:
            self._finished(work, message)


def serve(pipe: Connection) -> None:
    """Do the tasks that come through a pipe, until it is closed."""
    if hasattr(os, "setpgrp"):
        os.setpgrp()  # so that a cancel reaches the helpers, and Ctrl-C only the page
    with suppress(EOFError, OSError):
        while True:
            pipe.send_bytes(json.dumps(_done(json.loads(pipe.recv_bytes()), pipe), allow_nan=False).encode())


def _done(order: Message, pipe: Connection) -> Message:
    def report(done: float, words: str) -> None:
        pipe.send_bytes(json.dumps({"progress": float(done), "words": words}).encode())

    place = Workspace(Path(order["folder"]), Session.model_validate(order["session"]))
    try:
        return {"result": TASKS[order["task"]][0](Job(place, order["args"], report))}
    except UndertowError as error:
        return {"failed": str(error)}
    except (EOFError, BrokenPipeError):  # the page is gone, and nobody waits for this any more
        raise
    except Exception as error:
        traceback.print_exception(error)  # for the terminal, as the command line does
        return {"failed": f"this is a bug in undertow ({type(error).__name__}: {error}): please report it"}


@dataclass
class Bench:
    """What all windows share. Whoever changes it goes through the methods, which keep it in the file."""

    place: Workspace
    vehicle: Vehicle
    revision: int = 0
    failure: str = ""
    said: str = ""
    refused: str = ""
    runs: list[Run] = field(default_factory=list)
    before: list[Run] = field(default_factory=list)
    reading: bool = False
    work_by: type[Worker] = Worker

    def __post_init__(self) -> None:
        self._lock = threading.RLock()
        self.worker = self.work_by(self._finished)
        self.given = self.vehicle if len(self.session.steps) == 1 else _load(self.place, 0)

    @classmethod
    def open(cls, folder: Path, wanted: Session, work_by: type[Worker] = Worker) -> Bench:
        """The workbench on a session; the vehicle is read, the logs are not yet."""
        for log in wanted.logs:
            if not Path(log.path).exists():
                raise UndertowError(f"log '{log.path}' does not exist: check its name")
        place = Workspace.open(folder, wanted)
        bench = cls(place, _load(place), work_by=work_by)
        bench.read()
        return bench

    @property
    def session(self) -> Session:
        """What was chosen."""
        return self.place.session

    @property
    def work(self) -> Work | None:
        """What is being done."""
        return self.worker.work

    def changed(self) -> None:
        """Keep what was chosen, and let every window see it."""
        with self._lock:
            self.place.save()
            self.revision += 1

    def close(self) -> None:
        """End what is going on."""
        self.worker.close()

    # --- logs -----------------------------------------------------------------------------------
    def read(self) -> None:
        """Read the logs in a thread; windows see them when they are there."""
        self.reading, self.failure = True, ""
        self.revision += 1
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        try:
            runs = read_all(self.place, self.vehicle)
            mended = bool(self.session.remedies)
            before = read_all(self.place, self.vehicle, mended=False) if mended else []
            with self._lock:
                self.session.logs = self.session.chosen(runs)
                self.runs, self.before = runs, before
        except UndertowError as error:
            self.failure = str(error)
        finally:
            self.reading = False
            self.revision += 1

    def choose(self, log: int, role: Role, span: tuple[float, float] | None = None) -> None:
        """Say what is done with a log, or with a segment of it."""
        choice: LogChoice = self.session.logs[log]
        if span is None:
            choice.role, choice.stretches = role, []
        else:
            choice.stretches.append(LogSegment(start=min(span), end=max(span), role=role))
        self.session.written = []
        self.changed()

    def apply_remedy(self, remedy: Remedy) -> None:
        """Change the mapping as the doctor says, read the logs anew, and ask the doctor again."""
        self.place.state_mapping(self.runs[0].mapping)
        self.session.remedies.append(remedy)
        self._reread()
        self.start("examine")

    def undo_remedy(self) -> None:
        """Take the last remedy back."""
        self.session.remedies.pop()
        self._reread()

    def _reread(self) -> None:
        self.place.write_mapping()
        self.session.written = []
        self.changed()
        self.read()

    # --- models ---------------------------------------------------------------------------------
    def undo(self) -> None:
        """Go back to the model before; its file stays in the folder."""
        if len(self.session.steps) > 1 and self.work is None:  # what is being done is about this model
            last = self.session.steps.pop()
            self.vehicle = _load(self.place)
            self.said = f"undone: {last.what}"
            self.changed()

    def start(self, task: str, **args: Any) -> None:
        """Begin a task; a failure to begin is said like one of the task."""
        self.failure = self.said = self.refused = ""
        try:
            self.worker.start(self.place, task, args)
        except UndertowError as error:
            self.failure = str(error)
        self.revision += 1

    def cancel(self) -> None:
        """Give up what is being done."""
        if self.work is not None:
            self.said = f"cancelled: {TASKS[self.work.task][1]}"
            self.worker.cancel()
            self.revision += 1

    def _finished(self, work: Work, message: Message) -> None:
        with self._lock:
            self.failure = message.get("failed", "")
            try:
                if "result" in message:
                    self._take(work, message["result"])
            except UndertowError as error:
                self.failure = str(error)
            finally:
                self.worker.work = None
                self.changed()

    def _take(self, work: Work, result: Message) -> None:
        """Take over what a task found."""
        if "step" in result and work.task in ("add", "fit", "edit"):
            self._step(result)
        if work.task in ("examine", "compare", "diagnose"):
            self.place.keep(work.task, work.key, result)
            self._asked(work.task)
        if work.task == "compare":
            self.session.steps[-1].errors |= result["errors"]
        if work.task == "fit":
            self.place.keep("fit", self.place.key, result)
        if work.task == "invent":
            self.place.take_effect(result["file"])
            self._asked(f"invent {result['effect']}")
            self.place.keep("invent", self.place.key, result)
        if "logs" in result:
            self.session.written = result["logs"]
        self.refused = result["effect"] if work.task == "add" and "step" not in result else ""
        self.said = self._words(work.task, result)

    def _asked(self, what: str) -> None:
        asked = self.session.steps[-1].asked
        if what not in asked:
            asked.append(what)

    def _step(self, result: Message) -> None:
        self.session.steps[-1].errors |= result.get("given", {})
        self.session.steps.append(ModelStep.model_validate(result["step"]))
        self.vehicle = _load(self.place)

    def _words(self, task: str, result: Message) -> str:
        if "written" in result:
            return f"wrote {', '.join(result['written'])}"
        if task == "add" and "step" not in result:
            return f"{result['sentence']} It was not added; 'Add anyway' does so regardless."
        return str(result.get("sentence", ""))


def _load(place: Workspace, step: int = -1) -> Vehicle:
    return load_vehicle(place.vehicle_file(step), effect_files=[Path(p) for p in place.session.effects])
