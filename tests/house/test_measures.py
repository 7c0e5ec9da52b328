"""The house keeps its measures: no circle between rooms, no crowded folder, few long or wide functions."""

from tests.house import measures

EVERY = measures.modules(measures.ROOT)
ARROWS = measures.imports(EVERY)
ROOMS = measures.rooms(measures.ROOT)


def test_no_folder_has_more_than_twenty_rooms() -> None:
    assert {folder: count for folder, count in ROOMS.items() if count > measures.MAX_ROOMS} == {}


def test_no_modules_and_no_rooms_of_any_folder_import_in_a_circle() -> None:
    assert measures.circles(ARROWS) == []
    for folder in ("", *ROOMS):
        inside = measures.arrows_between_rooms(folder.replace("/", "."), ARROWS)
        assert measures.circles(inside) == [], folder
