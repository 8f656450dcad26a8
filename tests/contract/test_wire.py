"""Tests of the messages of the wire: each sample of protocol/valid is accepted, each of protocol/invalid is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import simplejpeg

from carina.errors import ProtocolError
from carina.server.wire import messages as wire
from carina.server.wire.codec import OLD_WORDS, encode_picture
from carina.server.wire.generate import generated_files

REPOSITORY = Path(__file__).resolve().parents[2]
PROTOCOL = REPOSITORY / "protocol"
PARSERS = {
    "client": wire.parse_client_message,
    "server": wire.parse_server_message,
    "pictures": wire.parse_picture,
    "phone": wire.parse_phone_message,
    "to-phone": wire.parse_to_phone_message,
    "join": wire.parse_join_message,
    "to-join": wire.parse_to_join_message,
}


def samples(kind: str) -> list[Path]:
    found = sorted(p for p in (PROTOCOL / kind).rglob("*") if p.is_file())
    assert found, f"protocol/{kind} is empty"
    return found


def label(path: Path) -> str:
    return f"{path.parent.name}/{path.name}"


@pytest.mark.parametrize("path", samples("valid"), ids=label)
def test_valid_sample_messages_are_accepted(path):
    PARSERS[path.parent.name](path.read_bytes())


@pytest.mark.parametrize("path", samples("invalid"), ids=label)
def test_invalid_sample_messages_are_refused_with_a_code_and_a_message(path):
    with pytest.raises(ProtocolError) as refusal:
        PARSERS[path.parent.name](path.read_bytes())
    assert refusal.value.code.startswith("protocol.")
    assert len(str(refusal.value)) > 15
    assert "  " not in str(refusal.value)


@pytest.mark.parametrize("path", samples("invalid"), ids=label)
def test_invalid_sample_messages_are_refused_for_the_defect_in_their_name(path):
    with pytest.raises(ProtocolError) as refusal:
        PARSERS[path.parent.name](path.read_bytes())
    name = path.stem
    # A sample of an earlier version would be refused because of its type or its fields.
    assert ("has no field" in str(refusal.value)) <= ("without" in name or "missing" in name)
    assert ("unknown field" in str(refusal.value)) <= ("field" in name)
    assert (refusal.value.code == "protocol.type") <= bool({"type", "from", "local"} & set(name.split("-")))


@pytest.mark.parametrize(
    ("data", "message"), [(b"\0\0\0", "ends within its header"), (b"\0\0\0\0", "before the image data")]
)
def test_picture_message_that_ends_after_its_length_has_no_payload(data, message):
    with pytest.raises(ProtocolError, match=message):
        wire.parse_picture(data)


@pytest.mark.parametrize("path", samples("valid-1"), ids=label)
def test_commands_with_names_of_version_1_equal_the_present_commands(path):
    old = json.loads(path.read_bytes())
    now = json.loads(wire.encode_message(PARSERS[path.parent.name](path.read_bytes())))
    name, new_fields = OLD_WORDS[old["type"]]
    assert now == {new_fields.get(field, field): value for field, value in old.items()} | {"type": name}


def test_old_field_name_together_with_its_new_name_in_a_message_is_refused():
    with pytest.raises(ProtocolError, match="unknown field: 'mask'"):
        wire.parse_client_message('{"type": "set_mask", "mask": "round", "outline": "octagon"}')


def test_every_message_class_has_a_valid_sample():
    for kind, classes in (
        ("client", wire.CLIENT_MESSAGES),
        ("server", wire.SERVER_MESSAGES),
        ("phone", wire.PHONE_MESSAGES),
        ("to-phone", wire.TO_PHONE_MESSAGES),
        ("join", {"join", "settle", "set_fov"}),
        ("to-join", wire.TO_JOIN_MESSAGES),
    ):
        sampled = {json.loads(p.read_text(encoding="utf-8"))["type"] for p in (PROTOCOL / "valid" / kind).iterdir()}
        assert sampled == set(classes)


@pytest.mark.parametrize("path", [p for p in samples("valid") if p.suffix == ".json"], ids=label)
def test_message_that_is_read_and_written_again_is_unchanged(path):
    message = PARSERS[path.parent.name](path.read_bytes())
    assert json.loads(wire.encode_message(message)) == json.loads(path.read_bytes())


def test_add_branch_message_without_the_evidence_field_is_accepted_as_before():
    edit = {"kind": "add-branch", "lps": [1.0, 2.0, 3.0]}
    message = wire.parse_client_message(json.dumps({"type": "edit_tree", "edit": edit}))
    assert message.edit == wire.AddBranch((1.0, 2.0, 3.0), even_without_evidence=False)


def test_set_controls_message_with_the_eight_fields_of_older_programs_is_accepted():
    known = {"gain_mm": 2, "gain_turn": 1, "clutch": "hold", "speed_mm_s": 25, "turn_rad_s": 1}
    controls = {**known, "lever_inverted": False, "filter_on": True, "min_cutoff_hz": 20}
    message = wire.parse_client_message(json.dumps({"type": "set_controls", "controls": controls}))
    assert message.controls == wire.DeviceControls(gain_mm=2.0, clutch="hold")


@pytest.mark.parametrize("path", [p for p in samples("valid") if p.suffix == ".bin"], ids=label)
def test_picture_message_is_unchanged_by_reading_and_writing(path):
    header, payload = wire.parse_picture(path.read_bytes())
    assert encode_picture(header, payload) == path.read_bytes()
    if header.codec == "jpeg":
        assert simplejpeg.decode_jpeg(payload).shape == (header.height, header.width, 3)


@pytest.mark.parametrize("name", generated_files())
def test_generated_protocol_files_are_up_to_date(name):
    expected = generated_files()[name]
    found = (REPOSITORY / name).read_text(encoding="utf-8")
    assert found == expected, "run python -m carina.server.wire.generate"


def test_message_with_a_nonfinite_number_is_never_written():
    status = wire.Status(fps=float("nan"), render_ms=1.0, age_ms=1.0, method="leap", threads=1, simd="")
    with pytest.raises(ValueError, match="not JSON compliant"):
        wire.encode_message(status)


@pytest.mark.parametrize("depth", [100_000])
def test_deep_nesting_in_a_message_is_refused_and_does_not_exhaust_the_stack(depth):
    text = '{"type": "set_transfer", "preset": null, "document": {"a": ' + "[" * depth + "]" * depth + "}}"
    with pytest.raises(ProtocolError):
        wire.parse_client_message(text)


def test_message_text_over_the_size_limit_is_refused_before_parsing():
    with pytest.raises(ProtocolError, match="too long") as refusal:
        wire.parse_client_message(" " * 300_000)
    assert refusal.value.code == "protocol.size"
