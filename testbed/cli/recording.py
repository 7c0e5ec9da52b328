"""`longreach recording`: what is in a recording, whether it is whole, and what can be made of it."""

from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.options import JsonFile
from testbed.cli.root import CommandApp
from testbed.reporting.console import out, promised, table, write_json

_HELP = "What is in a recording, whether it is whole, what can be made of it."
app = CommandApp(help=_HELP, no_args_is_help=True)

File = Annotated[Path, typer.Argument(metavar="FILE", help="A recording, such as truth.mcap.")]


@app.command(epilog="Example: longreach recording info runs/demo/plant_emulator/truth.mcap")
def info(file: File, json_file: JsonFile = None) -> None:
    """Topics, schemas, counts, rates and metadata of a recording; every checksum is verified.

    Exit status 1 when the file is damaged or was cut off: what is up to there can be read.
    """
    from foundation.recording.contents import contents

    found = contents(file)
    whole = found.complete and not found.damages and not found.stray
    length_s = (found.last_ns - found.first_ns) * 1e-9
    counts = {topic.name: found.counts.get(channel, 0) for channel, topic in found.topics.items()}
    rows = [
        (
            topic.name,
            topic.format.schema,
            counts[topic.name],
            f"{counts[topic.name] / max(length_s, 1e-9):.1f}",
        )
        for topic in found.topics.values()
    ]
    out.print(table("", ("topic", "schema", "messages", "a second"), rows))
    lines = [
        f"{name}: "
        + ", ".join(f"{key} {value if len(value) < 60 else '…'}" for key, value in entries.items())
        for name, entries in found.metadata.items()
    ]
    lines += [f"at byte {damage.offset}: {damage.what}" for damage in found.damages]
    lines += [f"{found.stray} messages of channels that are not described"] if found.stray else []
    lines += [f"{found.messages} messages, {length_s:.1f} s, {'whole' if whole else 'not whole'}"]
    for line in lines:
        out.print(line, highlight=False, markup=False)
    results = {"messages": found.messages, "counts": counts, "seconds": length_s, "whole": whole}
    results |= {"damages": [damage._asdict() for damage in found.damages], "metadata": found.metadata}
    write_json(json_file, results | {"complete": found.complete, "stray": found.stray})
    raise typer.Exit(0 if whole else 1)


@app.command("pictures", epilog="Example: longreach recording pictures drive.mcap --out drive")
def pictures_command(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="A ROS bag: a directory, .mcap, .db3 or .bag.")],
    directory: Annotated[Path, typer.Option("--out", help="Where left/, right/ and calibration.yaml go.")],
    left: Annotated[str | None, typer.Option(help="Topic of the left eye's pictures.")] = None,
    right: Annotated[str | None, typer.Option(help="Topic of the right eye's pictures.")] = None,
    json_file: JsonFile = None,
) -> None:
    """Write a ROS bag's stereo pictures as the directories that odometry, camera check and hand-eye read."""
    from testbed.recordings.bags import extract_pictures
    from testbed.reporting.console import bars

    with bars() as shown, shown.step("reading the bag") as bar:
        found = extract_pictures(bag, (left, right), promised(directory), bar.update)
    for note in found.pairs.notes:
        out.print(note, highlight=False, soft_wrap=True)
    lens = found.calibration or "no calibration"
    summary = (
        f"{len(found.pairs.files)} pairs of {found.topics[0]} and {found.topics[1]} in {directory}; {lens}"
    )
    out.print(summary, highlight=False, soft_wrap=True)
    results = {"pairs": len(found.pairs.files), "topics": found.topics, "notes": found.pairs.notes}
    write_json(json_file, results | {"calibration": found.calibration})
