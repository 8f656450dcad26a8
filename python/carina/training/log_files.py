"""Log of a scored flight as files: events, poses and scores as CSV, and xAPI statements as JSON.

The files contain no patient data and no time of day; the learner is a pseudonym.
"""

from __future__ import annotations

import csv
import io
import json
import urllib.parse
import uuid
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from carina.argument_checks import check_arguments, file_path, instance, text_of
from carina.disk.atomic_files import write_whole
from carina.training.score import Score

XAPI_VERSION = "1.0.3"
VERBS = {
    "attempted": "http://adlnet.gov/expapi/verbs/attempted",
    "completed": "http://adlnet.gov/expapi/verbs/completed",
    "experienced": "http://adlnet.gov/expapi/verbs/experienced",
}
ACTIVITY_TYPE = "http://adlnet.gov/expapi/activities/simulation"
PLACE = "urn:carina:training"
"""Prefix of the identifiers of tasks, segments and measures."""
LEARNERS = "https://carina.invalid/learners"
"""Home page of the pseudonymous accounts; the domain ``invalid`` never exists, so nothing is ever sent there."""
STATEMENTS_OF = {"visit", "revisit", "landmark", "entered", "held", "station", "reached"}
"""Kinds of events for which an xAPI statement is exported."""


def _csv(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows)
    return text.getvalue()


def events_csv(score: Score) -> str:
    """Return the events of a flight as CSV: time in s from the start of the recording, kind, name, detail."""
    rows = ((f"{one.time_s:.1f}", one.kind, one.name, one.detail) for one in score.events)
    return _csv(("time_s", "kind", "name", "detail"), rows)


def poses_csv(score: Score) -> str:
    """Return the poses of the tip at each frame as CSV: time in s, and ``lps_from_tip`` row by row in mm."""
    head = ("time_s", *(f"m{row}{column}" for row in range(3) for column in range(4)))
    frames = score.frames
    rows = (
        (f"{at:.1f}", *(repr(float(v)) for v in pose[:3].ravel()))
        for at, pose in zip(frames.times_s, frames.lps_from_tip, strict=True)
    )
    return _csv(head, rows)


def score_values(score: Score) -> dict[str, Any]:
    """Return the published scores, and the measures for which no pass mark is published, by name."""
    document = score.to_json()
    return {**document["published"], **document["without_mark"]}


def _validity(score: Score) -> dict[str, Any]:
    """Return whether an attempt counts towards mastery, and the codes of its doubts."""
    return {"counts_in_verdict": not score.doubts, "doubts": [one.code for one in score.doubts]}


def _xapi_score(score: Score) -> dict[str, Any]:
    """Return the xAPI score: segments seen for an inspection, otherwise the steps of the task that were done."""
    raw, most = score.diagnostic_completeness, score.num_case_segments
    if score.task.kind != "inspect":
        raw, most = len(score.result.steps_done), score.result.num_steps
    return {"raw": raw, "min": 0, "max": most, "scaled": raw / max(most, 1)}


def _iri(target: str) -> str:
    return f"{PLACE}:{urllib.parse.quote(target, safe=':-._~+')}"


def scores_csv(score: Score) -> str:
    """Return the scores as CSV: measure and value; an unknown value is empty."""
    values = {
        "task": score.task.name,
        "completed": score.result.completed,
        **_validity(score),
        **score_values(score),
    }
    values["doubts"] = " ".join(values["doubts"])
    return _csv(("measure", "value"), ((name, "" if value is None else value) for name, value in values.items()))


def xapi_statements(score: Score, *, learner: str = "learner") -> list[dict[str, Any]]:
    """Return the xAPI statements of an attempt: the attempt with its scores, and one for each visit and step.

    No statement contains ``success``, since a single attempt supports no verdict.

    Parameters
    ----------
    score
        Score of the attempt.
    learner
        Pseudonym of the learner.
    """
    digest = score.frames.pose_digest()
    actor = {"objectType": "Agent", "account": {"homePage": LEARNERS, "name": learner}}

    def statement(
        number: int, verb: str, target: str, name: str, *, result: dict[str, Any], kind: str | None = None
    ) -> dict[str, Any]:
        definition: dict[str, Any] = {"name": {"en": name}}
        if kind is not None:
            definition["type"] = kind
        return {
            "id": str(uuid.uuid5(uuid.NAMESPACE_URL, f"{PLACE}:{learner}:{score.task.name}:{digest}:{number}")),
            "version": XAPI_VERSION,
            "actor": actor,
            "verb": {"id": VERBS[verb], "display": {"en": verb}},
            "object": {"objectType": "Activity", "id": _iri(target), "definition": definition},
            "result": result,
        }

    extensions = {**_validity(score), **score_values(score)}
    whole = statement(
        0,
        "completed" if score.result.completed and score.frames.complete else "attempted",
        f"task:{score.task.name}",
        score.task.title,
        result={
            "completion": score.result.completed and score.frames.complete,
            "duration": f"PT{score.procedure_time_s:.1f}S",
            "score": _xapi_score(score),
            "extensions": {f"{PLACE}:{name}": value for name, value in extensions.items()},
        },
        kind=ACTIVITY_TYPE,
    )
    found = [whole]
    for event in score.events:
        if event.kind in STATEMENTS_OF:
            target = f"{event.kind}:{event.name.replace(' ', '-')}"
            at_s = {f"{PLACE}:time_s": event.time_s}
            found.append(statement(len(found), "experienced", target, event.name, result={"extensions": at_s}))
    return found


@check_arguments(
    folder=file_path(),
    score=instance(Score, "get one from carina.score_recording"),
    learner=text_of(80),
)
def write_flight_log(folder: str | Path, score: Score, *, learner: str = "learner") -> tuple[Path, ...]:
    """Write the log of a scored flight: ``events.csv``, ``poses.csv``, ``scores.csv`` and ``xapi.json``.

    Parameters
    ----------
    folder
        Folder of the files, which is created if it does not exist.
    score
        Score of the flight.
    learner
        Pseudonym of the learner in the xAPI statements.

    Returns
    -------
    tuple
        Paths of the written files.

    Raises
    ------
    DiskError
        If a file cannot be written.
    """
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    files = flight_log(score, learner=learner)
    return tuple(write_whole(place / name, text.encode(), what=f"the log {name}") for name, text in files.items())


def flight_log(score: Score, *, learner: str = "learner") -> dict[str, str]:
    """Return the texts of the files that `write_flight_log` writes, by file name."""
    statements = json.dumps(xapi_statements(score, learner=learner), allow_nan=False, indent=2) + "\n"
    return {
        "events.csv": events_csv(score),
        "poses.csv": poses_csv(score),
        "scores.csv": scores_csv(score),
        "xapi.json": statements,
    }
