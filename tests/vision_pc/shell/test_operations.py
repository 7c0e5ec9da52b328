"""What an operation keeps of what is reported about it."""

from vision_pc.shell.rest.operations import Operation


def test_a_report_that_says_nothing_new_is_no_note() -> None:
    operation = Operation("look", {})
    for progress, note in ((0.1, "looking"), (0.1, "looking"), (0.2, "looking"), (0.2, "matching")):
        operation.report(progress, note)
    assert operation.notes == [(0.1, "looking"), (0.2, "looking"), (0.2, "matching")]
    assert operation.revision == 3, "nobody who waits for a change is woken for none"
