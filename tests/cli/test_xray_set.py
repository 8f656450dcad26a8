"""Tests of ``carina render --view xray-set``, which renders the three X-rays side by side."""

from __future__ import annotations

import pytest

import carina as product


def test_command_writes_the_three_xrays_side_by_side_with_the_tip(carina, ct, tmp_path):
    output = tmp_path / "set.png"
    x, y, z = product.open_volume(ct).centre_lps
    options = ["--view", "xray-set", "--size", "96x96", "--json"]
    ended = carina("render", ct, *options, "-o", output, "--at", f"{x},{y},{z}")
    assert ended.code == 0, ended.err
    found = ended.json()
    assert found["size"] == [3 * 96 + 8, 96]
    assert found["views"] == ["xray-coronal", "xray-sagittal", "xray-axial"]
    assert output.read_bytes()[16:24] == (296).to_bytes(4, "big") + (96).to_bytes(4, "big")
    plain = tmp_path / "plain.png"
    assert carina("render", ct, *options, "-o", plain).code == 0
    assert plain.read_bytes() != output.read_bytes()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--size", "96x64"], "--size: each X-ray of the set is square; found 96x64"),
        (["--look", "0,0,-1"], "--look only applies to other views; the view is 'xray-set'"),
        (["--transfer", "paper"], "--transfer only applies to other views"),
    ],
)
def test_option_without_effect_on_the_xray_set_is_refused(carina, ct, tmp_path, options, message):
    ended = carina("render", ct, "--view", "xray-set", "-o", tmp_path / "set.png", *options)
    assert ended.code == 2
    assert message in ended.err
    assert not (tmp_path / "set.png").exists()
