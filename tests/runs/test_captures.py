"""Captures of one name: told apart where they are not the same data, and only there."""

from __future__ import annotations

from envgs_bench.captures import Capture, places, told_apart


def test_folders_of_one_name_are_told_apart_by_what_differs_above_them() -> None:
    rooms = [Capture("undistorted", f"/scans/{room}/undistorted", room) for room in ("roomA", "roomB")]
    assert places(rooms) == ["roomA", "roomB"]
    assert told_apart([*rooms, Capture("toy", "")]) == ["undistorted [root=roomA]", "undistorted [root=roomB]", "toy"]
    deep = [Capture("u", f"/{place}/u", place) for place in ("a/r", "b/r", "a/s")]
    assert places(deep) == ["a-r", "b-r", "a-s"]
    assert places([Capture("mine", "/a/x", "1"), Capture("mine", "/a/y", "2")]) == ["x", "y"]


def test_the_same_data_have_one_name() -> None:
    """Moved, corrected in place, both, or of records that do not know what was read."""
    moved = [Capture("u", "/here/u", "1"), Capture("u", "/there/u", "1")]
    corrected = Capture("u", "/there/u", "2")
    assert places([*moved, corrected]) == ["", "", ""]
    assert places([Capture("u", "/here/u"), Capture("u", "/there/u")]) == ["", ""]
