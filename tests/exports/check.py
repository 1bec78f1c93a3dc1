"""Opens exports with VTK, trimesh and pandas, and compares what they find with what was to be written.

    python3 tests/exports/check.py [--spoil] DIR

DIR is what the example `synthetic` of powderline-view wrote: `vtk`, `ply`, `csv`, and `expected.json`, which says what
must be in them. With --spoil single values are then changed in copies of the files, and each change must be found.
"""

import argparse
import json
import pathlib
import shutil
import sys
import tempfile
import xml.etree.ElementTree as xml

import numpy
import pandas
import trimesh
import vtk
from vtk.util.numpy_support import vtk_to_numpy

# Values are the same bits; only the order in which they are summed differs.
SAME = 1e-11

# Speeds are single precision, and were expected in double precision.
SPEED = 1e-6


class Differs(Exception):
    """An export that does not hold what it should."""


def same(what, found, expected):
    if found != expected:
        raise Differs(f"{what}: {found}, not {expected}")


def close(what, found, expected, share, scale):
    """Numbers that differ by at most a share of a scale; what is not a number is never close."""
    found, expected = numpy.asarray(found, float), numpy.asarray(expected, float)
    if found.shape != expected.shape or not (abs(found - expected) <= share * numpy.asarray(scale)).all():
        raise Differs(f"{what}: {found.tolist()}, not {expected.tolist()}")


def sums(what, values, expected, share=SAME):
    """Sum of values, and of values times their number from 1, against what was expected."""
    values = numpy.asarray(values, dtype=float)
    numbers = numpy.arange(1, len(values) + 1).reshape([-1] + [1] * (values.ndim - 1))
    found = [values.sum(axis=0), (values * numbers).sum(axis=0)]
    scale = [abs(values).sum(axis=0) + 1e-30, abs(values * numbers).sum(axis=0) + 1e-30]
    close(f"sums of {what}", found, expected, share, scale)


def solid(what, points, triangles, expected):
    """A surface: counts, corners, and the volume, which tells triangles that have other corners."""
    points, triangles = numpy.asarray(points, float), numpy.asarray(triangles)
    same(f"{what}: corners", len(points), expected["points"])
    same(f"{what}: triangles", triangles.shape, (expected["triangles"], 3))
    same(f"{what}: triangles with corners that are none", int((triangles >= len(points)).sum()), 0)
    sums(f"{what}'s corners", points, expected["corners_m"])
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    volumes = (a * numpy.cross(b, c)).sum(axis=1) / 6
    close(f"{what}'s volume", volumes.sum(), expected["volume_m3"], 1e-9, abs(volumes).sum())


def powder(what, expected, positions, velocities, speeds):
    same(f"{what}: particles", len(positions), expected["particles"])
    frame = expected["frame"]
    sums(f"{what}'s positions", positions, frame["positions_m"])
    sums(f"{what}'s velocities", velocities, frame["velocities_m_s"])
    if speeds is not None:
        sums(f"{what}'s speeds", speeds, frame["speeds_m_s"], SPEED)


def destinations(folder, expected):
    table = pandas.read_csv(folder / "destinations.csv")
    same(f"{folder.name}: columns of destinations", list(table.columns), ["particle", "destination"])
    numbers = list(range(expected["particles"]))
    same(f"{folder.name}: particles with a destination", table.particle.tolist(), numbers)
    found = {name: int((table.destination == name).sum()) for name in expected["destinations"]}
    same(f"{folder.name}: destinations", found, expected["destinations"])


def frames(expected):
    """What each frame is to be, with what is the same in all."""
    return [{"frame": frame, "particles": expected["particles"]} for frame in expected["frames"]]


def check_vtk(folder, expected):
    parts = {}
    for entry in xml.parse(folder / "series.pvd").getroot().iter("DataSet"):
        parts.setdefault(float(entry.get("timestep")), {})[entry.get("name")] = entry.get("file")
    same("series.pvd: times", list(parts), [frame["time_s"] for frame in expected["frames"]])
    named = {name for files in parts.values() for name in files.values()}
    same("vtk: files", named, {path.name for path in folder.glob("*.vtp")})
    for one, files in zip(frames(expected), parts.values()):
        gates = ["gates"] if one["frame"]["gates"] else []
        same("series.pvd: parts", sorted(files), ["containers", *gates, "powder", "tool"])
        data = read_vtk(folder / files["powder"])
        count = expected["particles"]
        same(f"{files['powder']}: cells", data.GetNumberOfVerts(), count)
        cells = vtk_to_numpy(data.GetVerts().GetConnectivityArray()).tolist()
        same(f"{files['powder']}: points of the cells", cells, list(range(count)))
        arrays = data.GetPointData()
        same(f"{files['powder']}: shown as colour", arrays.GetScalars().GetName(), "speed")
        same(f"{files['powder']}: shown as arrows", arrays.GetVectors().GetName(), "velocity")
        value = lambda name: vtk_to_numpy(arrays.GetArray(name))
        same(f"{files['powder']}: numbers", value("particle").tolist(), list(range(count)))
        powder(files["powder"], one, points_of(data), value("velocity"), value("speed"))
        solid(files["tool"], *surface_of(read_vtk(folder / files["tool"])), one["frame"]["tool"])
        for name in gates:
            solid(files[name], *surface_of(read_vtk(folder / files[name])), one["frame"][name])
        surface = surface_of(read_vtk(folder / files["containers"]))
        solid(files["containers"], *surface, expected["containers"])
    destinations(folder, expected)


def read_vtk(path):
    """VTK tells of errors on standard error only, unless it is listened to."""
    errors = []
    reader = vtk.vtkXMLPolyDataReader()
    reader.AddObserver("ErrorEvent", lambda *_: errors.append("VTK cannot read it"))
    reader.SetFileName(str(path))
    reader.Update()
    same(path.name, errors, [])
    return reader.GetOutput()


def points_of(data):
    return vtk_to_numpy(data.GetPoints().GetData())


def surface_of(data):
    return points_of(data), vtk_to_numpy(data.GetPolys().GetConnectivityArray()).reshape(-1, 3)


def check_ply(folder, expected):
    numbers = [f"{frame['index']:04}" for frame in expected["frames"]]
    bodies = [["tool", *(["gates"] if frame["gates"] else [])] for frame in expected["frames"]]
    names = [f"{part}-{number}.ply" for number, of in zip(numbers, bodies) for part in ("powder", *of)]
    same("ply: files", {path.name for path in folder.glob("*.ply")}, {"containers.ply", *names})
    for one, number, of in zip(frames(expected), numbers, bodies):
        for name in (f"{part}-{number}.ply" for part in ("powder", *of)):
            header = (folder / name).read_bytes().split(b"end_header")[0].decode()
            same(f"{name}: time", f"comment time_s {one['frame']['time_s']:g}" in header.splitlines(), True)
        name = f"powder-{number}.ply"
        cloud = trimesh.load(folder / name, process=False)
        values = cloud.metadata["_ply_raw"]["vertex"]["data"]
        velocities = numpy.stack([values[axis].ravel() for axis in ("vx", "vy", "vz")], axis=1)
        powder(name, one, cloud.vertices, velocities, values["speed"].ravel())
        for part in of:
            name = f"{part}-{number}.ply"
            mesh = trimesh.load(folder / name, process=False)
            solid(name, mesh.vertices, mesh.faces, one["frame"][part])
    mesh = trimesh.load(folder / "containers.ply", process=False)
    solid("containers.ply", mesh.vertices, mesh.faces, expected["containers"])
    destinations(folder, expected)


def check_csv(folder, expected):
    table, tool = pandas.read_csv(folder / "particles.csv"), pandas.read_csv(folder / "tool.csv")
    times = [frame["time_s"] for frame in expected["frames"]]
    same("particles.csv: times", table.time_s.unique().tolist(), times)
    for one, (_, rows) in zip(frames(expected), table.groupby("time_s")):
        what = f"particles.csv at {one['frame']['time_s']} s"
        same(f"{what}: numbers", rows.particle.tolist(), list(range(expected["particles"])))
        # Numbers in text read back as the same single-precision number.
        values = rows.drop(columns=["time_s", "particle"]).astype(numpy.float32)
        positions, velocities = values[["x_m", "y_m", "z_m"]], values[["vx_m_s", "vy_m_s", "vz_m_s"]]
        powder(what, one, positions.to_numpy(), velocities.to_numpy(), None)
    same("tool.csv: times", tool.time_s.tolist(), times)
    columns = ["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"]
    for frame, row in zip(expected["frames"], tool.to_dict("records")):
        pose("tool.csv: tool", [row[name] for name in columns], frame["pose"])
        pose("tool.csv: planned", [row[f"planned_{name}"] for name in columns], frame["planned"])
    destinations(folder, expected)


def pose(what, found, expected):
    """Cells of a pose; all of them are empty where there is none."""
    if expected is None:
        same(what, list(numpy.isnan(found)), [True] * 7)
    else:
        close(what, found, expected, 1e-12, 1.0)


CHECKS = {"vtk": check_vtk, "ply": check_ply, "csv": check_csv}


def spoil_byte(path, from_end):
    """Flips one bit, so many bytes from the end."""
    data = bytearray(path.read_bytes())
    data[len(data) - from_end] ^= 0x10
    path.write_bytes(data)


def spoil_text(path, old, new):
    text = path.read_text()
    if old not in text:
        raise SystemExit(f"{path.name} has no {old!r} to be changed")
    path.write_text(text.replace(old, new, 1))


def spoil_number(path, line, column):
    """Changes one number of a table by a millionth of it: single precision has one digit more."""
    lines = path.read_text().splitlines()
    cells = lines[line].split(",")
    cells[column] = repr(float(cells[column]) * (1 + 1e-6))
    lines[line] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")


def spoilings(expected):
    """What is changed, in which folder, and how."""
    # The arrays' lengths take eight bytes each; behind the points and velocities come speeds, numbers and cells.
    count = expected["particles"]
    footer = len("</AppendedData>\n</VTKFile>\n")
    first_number = footer + 3 * (8 + 4 * count) - 8
    last_velocity = footer + 4 * (8 + 4 * count) + 2
    # A frame in which the last particle moves, too: zero would become a number too small to matter.
    name = f"powder-{expected['frames'][2]['index']:04}"
    return [
        ("a velocity", "vtk", lambda at: spoil_byte(at / f"{name}.vtp", last_velocity)),
        ("a particle's number", "vtk", lambda at: spoil_byte(at / f"{name}.vtp", first_number)),
        ("a time", "vtk", lambda at: spoil_text(at / "series.pvd", 'timestep="1"', 'timestep="1.01"')),
        ("a file's presence", "vtk", lambda at: (at / f"{name}.vtp").unlink()),
        ("a velocity", "ply", lambda at: spoil_byte(at / f"{name}.ply", 6)),
        ("a corner of a triangle", "ply", lambda at: spoil_byte(at / "containers.ply", 4)),
        ("a gate's presence", "ply", lambda at: (at / "gates-0100.ply").unlink()),
        ("a gate's place", "vtk", lambda at: shutil.copy(at / "gates-0300.vtp", at / "gates-0400.vtp")),
        ("a time", "ply", lambda at: spoil_bytes(at / "powder-0500.ply", b"time_s 5", b"time_s 6")),
        ("a position", "csv", lambda at: spoil_number(at / "particles.csv", 4321, 3)),
        ("two particles' order", "csv", lambda at: swap_rows(at / "particles.csv", 100)),
        ("the tool's place", "csv", lambda at: spoil_number(at / "tool.csv", 2, 1)),
        ("a destination", "csv", lambda at: spoil_text(at / "destinations.csv", "spilled", "source")),
    ]


def spoil_bytes(path, old, new):
    path.write_bytes(path.read_bytes().replace(old, new, 1))


def swap_rows(path, line):
    """Two particles' values change places, their numbers do not."""
    lines = path.read_text().splitlines()
    cells = [lines[at].split(",") for at in (line, line + 1)]
    for at, other in ((0, 1), (1, 0)):
        lines[line + at] = ",".join(cells[at][:2] + cells[other][2:])
    path.write_text("\n".join(lines) + "\n")


def check_spoilt(made, expected):
    """Changes that were not found."""
    unnoticed = []
    for what, kind, spoil in spoilings(expected):
        with tempfile.TemporaryDirectory() as copy:
            folder = pathlib.Path(shutil.copytree(made / kind, pathlib.Path(copy) / kind))
            spoil(folder)
            try:
                CHECKS[kind](folder, expected)
                unnoticed.append(f"{kind}: {what} was changed, and it was not noticed")
            except (Differs, OSError) as noticed:
                print(f"{kind}: {what} was changed, and that was noticed: {str(noticed)[:60]}")
    return unnoticed


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spoil", action="store_true")
    parser.add_argument("made", type=pathlib.Path)
    words = parser.parse_args()
    expected = json.loads((words.made / "expected.json").read_text())
    failures = []
    for kind, check in CHECKS.items():
        try:
            check(words.made / kind, expected)
            count = f"{len(expected['frames'])} frames of {expected['particles']} particles"
            print(f"{kind}: {count} are as they should be")
        except Differs as error:
            failures.append(f"{kind}: {error}")
    if words.spoil and not failures:
        failures = check_spoilt(words.made, expected)
    for failure in failures:
        print(failure, file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
