"""The live view is the page itself, served to this machine only and gone when closed."""

from __future__ import annotations

import logging
import re
import urllib.error
import urllib.request
import webbrowser

import pytest

from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.view import show
from redundancy_pin.visualisation.viewer import page as live_view

pytest.importorskip("meshcat")


def read(url: str) -> tuple[str, str]:
    with urllib.request.urlopen(url, timeout=10) as answer:
        return answer.headers["Content-Type"], answer.read().decode("utf-8")


def test_what_is_served_is_the_page_with_its_legend_and_controls() -> None:
    view = show("five_bar")
    live = view.serve()
    try:
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", live.url)
        kind, text = read(live.url)
        assert kind == "text/html; charset=utf-8"
        assert text == view.html()
        assert read(f"{live.url}?again")[1] == text
        for control in ("forces", "scale", "path", "speed", "time"):
            assert f'id="{control}"' in text
        with pytest.raises(urllib.error.HTTPError, match="404"):
            read(f"{live.url}etc/passwd")
    finally:
        live.close()
    with pytest.raises(OSError, match="refused"):
        read(live.url)


def test_two_views_have_two_addresses() -> None:
    first, second = live_view.serve_page("one"), live_view.serve_page("two")
    try:
        assert read(first.url)[1] == "one"
        assert read(second.url)[1] == "two"
    finally:
        first.close()
        second.close()


def test_requests_are_no_chatter(caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]) -> None:
    live = live_view.serve_page("page")
    try:
        with caplog.at_level(logging.INFO):
            read(live.url)
    finally:
        live.close()
    assert caplog.records == []
    assert capsys.readouterr() == ("", "")


def test_a_browser_is_opened_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    view = show("five_bar")
    live = view.serve()
    live.close()
    assert opened == []
    live = view.serve(open_browser=True)
    live.close()
    assert opened == [live.url]


def test_waiting_ends_when_the_view_is_closed() -> None:
    live = live_view.serve_page("page")
    live.close()
    live.wait()


def test_no_port_is_an_error_with_a_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_view, "HERE", "203.0.113.1")  # an address for documentation: of no machine
    with pytest.raises(RedundancyPinError, match="No port of") as raised:
        live_view.serve_page("page")
    assert "--html" in raised.value.remedy
