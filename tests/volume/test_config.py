"""Tests of the settings that are read from environment variables."""

from __future__ import annotations

from pathlib import Path

import pytest

from carina.config import load_settings
from carina.errors import UsageError


def test_settings_without_environment_variables_have_their_defaults():
    settings = load_settings({})
    assert settings.log_level == "WARNING"
    assert settings.data_dir is None
    assert settings.backend == "auto"
    assert "carina" in settings.cache_dir.name.lower()


def test_settings_are_read_from_environment_variables():
    settings = load_settings({"CARINA_LOG_LEVEL": " debug ", "CARINA_DATA_DIR": "some/folder", "CARINA_BACKEND": "CPU"})
    assert settings.log_level == "DEBUG"
    assert settings.data_dir == Path("some/folder")
    assert settings.backend == "cpu"


def test_unknown_log_level_is_refused():
    with pytest.raises(UsageError, match="LOUD"):
        load_settings({"CARINA_LOG_LEVEL": "loud"})


def test_unknown_render_backend_is_refused():
    with pytest.raises(UsageError, match="abacus"):
        load_settings({"CARINA_BACKEND": "abacus"})


@pytest.mark.parametrize(("text", "num_bytes"), [("", None), ("0", 0), (" 2.5 ", 2_500_000_000)])
def test_cache_limit_is_read_from_the_environment(text, num_bytes):
    assert load_settings({"CARINA_CACHE_GB": text}).volume_cache_bytes == num_bytes


@pytest.mark.parametrize("text", ["much", "-1", "nan", "inf"])
def test_invalid_cache_limit_in_the_environment_is_refused(text):
    with pytest.raises(UsageError, match="gigabytes"):
        load_settings({"CARINA_CACHE_GB": text})
