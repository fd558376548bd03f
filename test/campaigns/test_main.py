"""The runner of the campaigns: each name stands for a module that can be imported and has a function `main`."""

from __future__ import annotations

from importlib import import_module

import pytest

from campaigns.__main__ import CAMPAIGNS, main

OURS = ("sfr_loc_map", "helpers", "campaigns")


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_each_campaign_can_be_started(name: str) -> None:
    try:
        module = import_module(f"campaigns.{CAMPAIGNS[name]}")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] in OURS:
            raise
        pytest.skip(f"{error.name} is not installed")
    assert callable(module.main)


def test_an_unknown_name_is_refused_with_the_names(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["unknown"]) == 2
    message = capsys.readouterr().err
    assert all(name in message for name in CAMPAIGNS)
