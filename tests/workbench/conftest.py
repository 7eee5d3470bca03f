"""What every test of the workbench begins with: a session that was worked out once."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.workbench.demo_session import FewEffects, session_of
from undertow.workbench.session import Workspace
from undertow.workbench.tasks import Job, compare, diagnose


@pytest.fixture(scope="session")
def worked_out(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """Where the model fails and what is missing, found by the real tasks."""
    folder = tmp_path_factory.mktemp("workbench")
    place = Workspace.open(folder / "kept", session_of(folder))
    for name, task in (("compare", compare), ("diagnose", diagnose)):
        place.keep(name, place.key, task(FewEffects(place, {}, lambda done, words: None)))
        place.session.steps[-1].asked.append(name)
    place.save()
    return place


@pytest.fixture
def place(worked_out: Workspace, tmp_path: Path) -> Workspace:
    """A copy of that session, to be changed."""
    shutil.copytree(worked_out.folder, tmp_path / "kept")
    own = session_of(tmp_path).vehicle
    copied = worked_out.session.model_copy(deep=True, update={"vehicle": own})
    place = Workspace(tmp_path / "kept", copied)
    place.save()
    return place


@pytest.fixture
def job(place: Workspace) -> Callable[..., Job]:
    """Work on the session."""
    return lambda **args: FewEffects(place, args, lambda done, words: None)
