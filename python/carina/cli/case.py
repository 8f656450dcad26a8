"""``carina case``: the contents of case files, and the cases that are stored on this machine."""

from __future__ import annotations

import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from carina.case import CaseFile, RecordingFacts, migrate, rescued
from carina.cli.arguments import check_output_file
from carina.cli.console import print_json, print_note, print_result, progress_printer
from carina.cli.opened import case_scans, newest_case_file
from carina.config import load_settings
from carina.disk import say_size, write_whole
from carina.disk.move_files import move_to_new_name
from carina.errors import DiskError, UsageError
from carina.navigate import Recording, open_recording
from carina.session import CASE_SUFFIX, CaseRecord, CaseRecords, LocalStore, is_case_file
from carina.session.store.registry_repair import repair_records
from carina.volume import VolumeCache

SHORT_ID = 6


def case_json(path: Path) -> dict[str, Any]:
    """Return the contents of a case file for ``--json``; its CT is not needed."""
    with CaseFile.open(newest_case_file(path), read_only=True) as case:
        source, steps, holds = case.source, case.history(), case.summary()
        recordings = case.recordings()
        note = case.note
    return {
        "file": str(path),
        "bytes": path.stat().st_size,
        "note": note,
        "source": {
            "digest": source.digest,
            "shape_zyx": list(source.shape_zyx),
            "lps_from_ijk": source.lps_from_ijk.tolist(),
            "is_hu": source.is_hu,
            "path": source.path,
            "packed": holds.is_packed,
        },
        "num_branches": holds.num_branches,
        "num_edits": holds.num_edits,
        "measured": holds.is_measured,
        "route": holds.route,
        "targets": list(holds.targets),
        "key_frames": list(holds.key_frames),
        "recordings": [{"id": one.recording_id, "name": one.name, "length_s": one.length_s} for one in recordings],
        "num_steps": len(steps),
        "num_done": sum(step.holds for step in steps),
        "saved_by": holds.saved_by,
    }


def case_lines(path: Path) -> list[str]:
    """Return the contents of a case file as lines of text."""
    found = case_json(path)
    source = found["source"]
    nz, ny, nx = source["shape_zyx"]
    where = "packed with the case" if source["packed"] else source["path"] or "location unknown"
    lines = [
        f"{path.name}: {say_size(found['bytes'])}, "
        + (f"saved by Carina {found['saved_by']}" if found["saved_by"] else "not saved yet"),
        f"  scan: {nx} x {ny} x {nz} voxels, {where}, digest {source['digest'][:12]}",
        "  airways: none"
        if found["num_branches"] is None
        else f"  airways: {found['num_branches']} branches, {_count_text(found['num_edits'], 'edit')}, "
        + ("measured" if found["measured"] else "not measured yet"),
        f"  targets: {', '.join(found['targets']) or 'none'}",
        f"  key frames: {', '.join(found['key_frames']) or 'none'}",
    ]
    if found["route"] is not None:
        lines.append(f"  route: {found['route']}")
    if found["recordings"]:
        lines.append(f"  recordings: {', '.join(one['name'] or str(one['id']) for one in found['recordings'])}")
    undone = found["num_steps"] - found["num_done"]
    lines.append(f"  history: {_count_text(found['num_done'], 'change')}" + (f", {undone} undone" if undone else ""))
    if found["note"]:
        lines.append(f"  note: {found['note']}")
    return lines


def info(path: Path, *, as_json: bool) -> int:
    """Print what a case file contains."""
    if as_json:
        print_json(case_json(path))
    else:
        print_result(*case_lines(path))
    return 0


def history(path: Path, *, as_json: bool) -> int:
    """Print the labels of the steps, the oldest first, with the time since the case was begun."""
    with CaseFile.open(newest_case_file(path), read_only=True) as case:
        steps = case.history()
    if as_json:
        print_json({"steps": [{"n": n, **asdict(step)} for n, step in enumerate(steps, 1)]})
        return 0
    for n, step in enumerate(steps, 1):
        print_result(f"{n:>4}  {_duration_text(step.at_s):>9}  {step.label}{'' if step.holds else '  (undone)'}")
    if not steps:
        print_note("nothing has been changed in this case yet")
    return 0


def list_cases(*, as_json: bool) -> int:
    """Print the cases that are stored on this machine, the most recently used first."""
    records = _records()
    for message in repair_records(records):
        print_note(f"note: {message}")
    found = records.all()
    short = _short_ids(found)
    if as_json:
        print_json(
            {
                "cases": [
                    {
                        "id": one.case_id,
                        "title": one.shown_title,
                        "begun": _iso_time(one.begun_s),
                        "used": _iso_time(one.used_s),
                        "num_changes": one.num_changes,
                        "bytes": records.num_bytes(one),
                        "digest": one.digest,
                        "copy": one.copy_path,
                    }
                    for one in found
                ]
            }
        )
        return 0
    for one in found:
        used = time.strftime("%Y-%m-%d %H:%M", time.localtime(one.used_s))
        size = say_size(records.num_bytes(one))
        print_result(
            f"{short[one.case_id]:<8} {used}  {_count_text(one.num_changes, 'change'):>12}  {size:>9}  "
            f"{one.shown_title}"
        )
    if not found:
        print_note("no cases are stored on this machine")
    return 0


def forget(wanted: str, *, yes: bool, as_json: bool) -> int:
    """Delete all data of a case on this machine; files that the user saved elsewhere stay."""
    records = _records()
    record = _stored_case_by_name(records, wanted)
    cache = _cache()
    others = [one for one in records.all() if one.digest == record.digest and one.case_id != record.case_id]
    words = f"{record.shown_title}, {_count_text(record.num_changes, 'change')}"
    if not yes:
        if as_json or not sys.stdin.isatty():
            raise UsageError(f"this removes the case ({words}) from this machine permanently; add --yes to confirm")
        print_note(f"This removes the case ({words}) from this machine permanently.")
        if record.copy_path is not None:
            print_note(f"The file {record.copy_path} will not be deleted.")
        print("Remove it? [y/N] ", end="", file=sys.stderr, flush=True)
        if sys.stdin.readline().strip().lower() not in {"y", "yes"}:
            print_note("nothing was removed")
            return 0
    size = records.num_bytes(record)
    if not records.forget(record):
        raise UsageError("this case is open in Carina; close it there first", code="case.open")
    if not records.remove(record.case_id):
        raise DiskError("the case was removed from the list, but its folder could not be removed; try again later")
    if record.place is not None:
        LocalStore(load_settings().config_dir).forget(record.place)
    # The cached CT is not deleted while another case of the same CT needs it.
    freed = 0 if others else cache.forget(record.digest)
    if as_json:
        print_json({"id": record.case_id, "bytes": size, "cache_bytes": freed, "copy": record.copy_path})
    else:
        print_note(f"removed: {words}; {say_size(size + freed)} freed")
        if record.copy_path is not None:
            print_note(f"the file {record.copy_path} was not deleted")
    return 0


def pack_case(path: Path, *, output: Path, ct: Path | None, as_json: bool) -> int:
    """Write a case and its CT to one file."""
    _check_target(path, output)
    with CaseFile.open(newest_case_file(path), read_only=True) as case:
        volume = case_scans().open(case, ct=ct, progress=progress_printer()).volume
        case.write_copy(output, volume=volume, placement=move_to_new_name)
    return _print_written_file(output, as_json)


def migrate_case(path: Path, *, output: Path, as_json: bool) -> int:
    """Convert a case of an older version of Carina to the present format."""
    _check_target(path, output)
    migrate(path, output)
    return _print_written_file(output, as_json)


def rescue(path: Path, *, output: Path, as_json: bool) -> int:
    """Write the intact parts of a damaged case to a new file, and list what was lost."""
    _check_target(path, output)
    lost = rescued(path, output)
    for words in lost:
        print_note(f"lost: {words}")
    return _print_written_file(output, as_json, lost=list(lost))


def write_recording(path: Path, wanted: str, *, output: Path, as_json: bool) -> int:
    """Write a recording of a case to a separate file."""
    check_output_file(output, ".jsonl")
    if output.exists():
        raise UsageError(f"-o: {output} already exists; choose another name", code="case.exists")
    with CaseFile.open(newest_case_file(path), read_only=True) as case:
        text = case.recording_text(find_recording(case, wanted).recording_id)
    write_whole(output, text.encode(), what="the recording", placement=move_to_new_name)
    return _print_written_file(output, as_json)


def open_case_recording(path: Path, wanted: Path) -> Recording:
    """Return the recording in a file, or a recording of the case by its name or number."""
    if wanted.is_file() or not is_case_file(path):
        return open_recording(wanted)
    with CaseFile.open(newest_case_file(path), read_only=True) as case:
        return case.recording(find_recording(case, str(wanted)).recording_id)


def find_recording(case: CaseFile, wanted: str) -> RecordingFacts:
    """Return a recording of a case by its name, else by its number.

    Raises
    ------
    UsageError
        ``case.write_recording``: if there is none, or several have that name.
    """
    all_recordings = case.recordings()
    found = [one for one in all_recordings if one.name == wanted]
    if not found:
        found = [one for one in all_recordings if str(one.recording_id) == wanted]
    if len(found) == 1:
        return found[0]
    if found:
        raise UsageError(
            f"{len(found)} recordings of this case have the name {wanted!r}; use one of their numbers "
            f"({', '.join(str(one.recording_id) for one in found)})",
            code="case.recording",
        )
    names = ", ".join(f"{one.name} ({one.recording_id})" for one in all_recordings)
    raise UsageError(
        f"this case has no recording {wanted!r}; its recordings: " + (names or "none"),
        code="case.recording",
    )


def _print_written_file(output: Path, as_json: bool, **facts: Any) -> int:
    if as_json:
        print_json({"file": str(output), "bytes": output.stat().st_size, **facts})
    else:
        print_note(f"wrote {output}: {say_size(output.stat().st_size)}")
    return 0


def _check_target(path: Path, output: Path) -> None:
    check_output_file(output, CASE_SUFFIX)
    if output.exists():
        raise UsageError(
            f"-o: {output} already exists; choose another name ({path.name} is never changed)", code="case.exists"
        )


def _records() -> CaseRecords:
    return CaseRecords(load_settings().cases_dir, time.time)


def _cache() -> VolumeCache:
    settings = load_settings()
    return VolumeCache(settings.cache_dir / "volumes", max_bytes=settings.volume_cache_bytes)


def _stored_case_by_name(records: CaseRecords, wanted: str) -> CaseRecord:
    """Return the stored case with this ID prefix or this file.

    Raises
    ------
    UsageError
        ``case.unknown``: if no stored case or several cases match.
    """
    all_records = records.all()
    if wanted.lower().endswith(CASE_SUFFIX):
        place = str(Path(wanted).expanduser().absolute())
        found = [one for one in all_records if one.copy_path == place or str(records.path_of(one)) == place]
    else:
        found = [one for one in all_records if wanted and one.case_id.startswith(wanted.lower())]
    if len(found) == 1:
        return found[0]
    what = "no case on this machine matches" if not found else f"{len(found)} cases on this machine match"
    raise UsageError(f"{what} {wanted}; `carina case list` shows the ids", code="case.unknown")


def _short_ids(records: tuple[CaseRecord, ...]) -> dict[str, str]:
    """Return the shortest unique prefix of each ID, with a minimum length."""
    ids = [one.case_id for one in records]
    length = SHORT_ID
    while len({one[:length] for one in ids}) < len(ids):
        length += 1
    return {one: one[:length] for one in ids}


def _count_text(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _duration_text(seconds: float) -> str:
    """Return a duration as hours, minutes and seconds."""
    whole = int(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02}:{whole % 60:02}"


def _iso_time(seconds: float) -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(seconds))
