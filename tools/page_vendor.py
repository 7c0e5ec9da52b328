"""The libraries of our pages, made again from the npm registry: ``python -m tools.page_vendor``.

Needs npm. Packages are exact in version, their archives are checked against the hashes below, and nothing of
theirs is run but esbuild, which bundles. ``THIRD_PARTY.md`` beside the files says what they are.
"""

import base64
import hashlib
import json
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
CONSOLE = ROOT / "vision_pc" / "shell" / "rest" / "console" / "page" / "vendor"
DOCS = ROOT / "foundation" / "rest" / "docs" / "vendor"
_THREE = (
    "AmbientLight, BoxGeometry, BufferAttribute, BufferGeometry, Color, CylinderGeometry, DirectionalLight, "
    "DoubleSide, GridHelper, Group, HemisphereLight, Line, LineBasicMaterial, LineDashedMaterial, "
    "LineSegments, Matrix4, Mesh, MeshBasicMaterial, MeshLambertMaterial, PerspectiveCamera, PlaneGeometry, "
    "Quaternion, Scene, SphereGeometry, Vector3, WebGLRenderer"
)
_THREE_ENTRY = (
    f"export {{{_THREE}}} from './three/package/build/three.module.js';\n"
    "export {OrbitControls} from './three/package/examples/jsm/controls/OrbitControls.js';\n"
)


class Package(NamedTuple):
    """A package of the registry: exact version, the archive's sha512, its licence and where the texts are."""

    name: str
    version: str
    integrity: str
    licence: str
    texts: tuple[str, ...] = ("LICENSE",)


class Made(NamedTuple):
    """A file that is checked in: its folder and name, its package, and where it is made from.

    ``source``: a file in the archive; ``entry``: a module that is bundled to it instead.
    """

    folder: Path
    name: str
    package: str
    source: str
    entry: str = ""


PACKAGES = {
    package.name: package
    for package in (
        Package(
            "three",
            "0.187.0",
            "Qiu7R+Cmh8CstZsY1uJOSWnVlfo7ZtNLV7mF8Jltk3LB3AtDu9cRZlcnRKkAk8Y4z6KKw35z7Y7Urd7jWY8etA==",
            "MIT",
        ),
        Package(
            "uplot",
            "1.6.32",
            "KIMVnG68zvu5XXUbC4LQEPnhwOxBuLyW1AHtpm6IKTXImkbLgkMy+jabjLgSLMasNuGGzQm/ep3tOkyTxpiQIw==",
            "MIT",
        ),
        Package(
            "swagger-ui-dist",
            "5.35.0",
            "U06rpMtW9V3XPGOBeamTUSr0Z09jMX4IJuANpE/EZbAhw0G8CgwrzU4YmXkn/h0wCDNsXdGarTNNHC3sU8yVUQ==",
            "Apache-2.0",
            ("LICENSE", "NOTICE", "swagger-ui-bundle.js.LICENSE.txt"),
        ),
        Package(
            "@esbuild/linux-x64",
            "0.28.2",
            "4xTZr1FUmSoQW4XIWmit3tzQrUTZM+N3P0XV8xROKYF50XfI7xeO90+1bZvNwxIufQ9hDQVRJH5YhgPVF8A/HQ==",
            "MIT",
        ),
    )
}
_UPLOT_ENTRY = "export {default} from './uplot/package/dist/uPlot.esm.js';\n"
FILES = (
    Made(CONSOLE, "three.js", "three", "", _THREE_ENTRY),
    Made(CONSOLE, "uplot.js", "uplot", "", _UPLOT_ENTRY),
    Made(CONSOLE, "uplot.css", "uplot", "dist/uPlot.min.css"),
    Made(DOCS, "swagger-ui.js", "swagger-ui-dist", "swagger-ui-bundle.js"),
    Made(DOCS, "swagger-ui.css", "swagger-ui-dist", "swagger-ui.css"),
)
_BUNDLE = ("--bundle", "--format=esm", "--minify", "--target=es2022", "--legal-comments=none")


def main() -> int:
    """Write every file anew, with the pages that say what they are."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for package in PACKAGES.values():
            unpack(package, folder)
        (folder / "package.json").write_text(json.dumps({"type": "module"}))
        for made in FILES:
            made.folder.mkdir(parents=True, exist_ok=True)
            (made.folder / made.name).write_bytes(content(made, folder))
        for place in {made.folder for made in FILES}:
            (place / "THIRD_PARTY.md").write_text(third_party(place, folder), encoding="utf-8")
    return 0


def unpack(package: Package, folder: Path) -> None:
    """Fetch the archive of ``package``, refuse one with another hash, and unpack it below ``folder``."""
    place = folder / short(package.name)
    place.mkdir()
    command = ["npm", "pack", "--silent", f"{package.name}@{package.version}"]
    named = subprocess.run(command, cwd=place, check=True, capture_output=True, text=True).stdout.strip()
    archive = place / named.splitlines()[-1]
    found = base64.b64encode(hashlib.sha512(archive.read_bytes()).digest()).decode()
    if found != package.integrity:
        sys.exit(f"{package.name} {package.version}: sha512 {found}, wanted {package.integrity}")
    with tarfile.open(archive) as packed:
        packed.extractall(place, filter="data")


def content(made: Made, folder: Path) -> bytes:
    """The bytes of one file."""
    if not made.entry:
        data = (folder / short(made.package) / "package" / made.source).read_bytes()
        return b"\n".join(line for line in data.split(b"\n") if b"sourceMappingURL=" not in line)
    entry = folder / f"entry-{made.name}"
    # OrbitControls asks for 'three' by that name.
    entry.write_text(made.entry)
    esbuild = folder / "esbuild" / "package" / "bin" / "esbuild"
    alias = f"--alias:three={folder}/three/package/build/three.module.js"
    bundled = subprocess.run([esbuild, entry, *_BUNDLE, alias], check=True, capture_output=True)
    return bundled.stdout


def third_party(place: Path, folder: Path) -> str:
    """The page of one folder: every file with its package, licence and hash, then the licences' texts."""
    files = [made for made in FILES if made.folder == place]
    lines = ["# Libraries of others", "", "Made by `make page-vendor` (`tools/page_vendor.py`).", ""]
    lines += ["| file | package | licence | sha256 |", "|---|---|---|---|"]
    for made in files:
        package = PACKAGES[made.package]
        digest = hashlib.sha256((place / made.name).read_bytes()).hexdigest()
        lines.append(f"| {made.name} | {package.name} {package.version} | {package.licence} | {digest} |")
    for name in dict.fromkeys(made.package for made in files):
        lines += ["", f"## {name}"]
        for text in PACKAGES[name].texts:
            words = (folder / short(name) / "package" / text).read_text(encoding="utf-8")
            lines += ["", "```", words.strip(), "```"]
    return "\n".join(lines) + "\n"


def short(name: str) -> str:
    """A package's folder."""
    return name.split("/")[0].lstrip("@")


if __name__ == "__main__":
    sys.exit(main())
