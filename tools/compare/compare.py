#!/usr/bin/env python3
"""Time and error of curvox beside other programs, on the same volumes, in the same run.

In: the `curvox` command. Out: a Markdown table on the standard output. The others are installed from PyPI, at the
versions below, into a virtual environment of this script (--venv): DGtal's Python module (integral invariants and
the Voronoi covariance measure; it has no corrected curvature measures), and scikit-image's marching cubes with
PyVista's mean curvature of the mesh.

Every figure is processor time (user and system) on one thread, the median of --repeats turns in which each case is
run once, divided by the surfels of the volume, whatever the program has in their place. curvox is timed as a
command, from the file to a Parquet table of normals, H, G, k1 and k2; the others in this process, from the voxels
in memory to a list or an array, without reading the file. Errors of H are taken at the closest point of the true
surface, in units of the shape, over all surfels or vertices.

    cargo build --release
    python3 tools/compare/compare.py --curvox target/release/curvox
"""

import argparse
import csv
import os
import pathlib
import subprocess
import sys
import tempfile
import time
import venv

PACKAGES = ["dgtal==2.2.0", "numpy==2.4.6", "scikit-image==0.26.0", "pyvista==0.49.1"]

# One thread, also in what the packages call.
ONE_THREAD = {
    name: "1"
    for name in ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VTK_SMP_MAX_THREADS"]
}

# Radius of the offset of VCM over that of its kernel: as in the paper, and curvox's default.
VCM_OFFSET = 10 / 3

# Blur of the voxels before marching cubes (standard deviation, in voxels): from none to as much as hides the staircase.
BLURS = [0.0, 1.0, 2.0, 4.0]

# Processor time of DGtal's corrected curvature measures (H, G, k1, k2, d1, d2 with II normals at the same radius)
# on Goursat's surface, microseconds a surfel, by gridstep h, at radius 3 h^(-1/2) voxels. Measured with DGtal 2.1.1 (development head,
# commit 1574af90 of 2026-06-07; C++20, g++ 12.2, -O3 -march=native), on a similar machine, not in the same run:
# surface, II normals, mesh, four measures, four sums over balls.
DGTAL_CORRECTED = {1.0: 126, 0.5: 253, 0.25: 530, 0.125: 1670, 0.0625: 3700}

CORRECTED = "DGtal, corrected measures, in another run"

# What a program has to do for what one run of curvox gives. Curvatures by integral invariants are one run there, with
# normals and the table; corrected curvatures come with the normals of --normals.
SUMS = {
    "DGtal, surface + II normals": ["DGtal, surface", "DGtal, II normals"],
    "DGtal, surface + VCM normals": ["DGtal, surface", "DGtal, VCM normals"],
    "DGtal, surface + II normals, H, G, k1, k2": [
        "DGtal, surface",
        "DGtal, II normals",
        "DGtal, II mean curvature",
        "DGtal, II Gaussian curvature",
        "DGtal, II principal curvatures",
    ],
}

# The run of curvox that they stand beside.
BESIDE = {
    "DGtal, surface + II normals": "`--normals ii`",
    "DGtal, surface + VCM normals": "`--normals vcm`",
    "DGtal, surface + II normals, H, G, k1, k2": "`--curvature ii`",
    CORRECTED: "`--method paper`",
}


def arguments():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--curvox", default="target/release/curvox", help="the command to measure")
    parser.add_argument(
        "--venv", default="target/compare-venv", help="where the other programs are installed"
    )
    parser.add_argument(
        "--shapes", default="sphere:radius=9,goursat", help="shapes of `curvox shape` with a truth here"
    )
    parser.add_argument("--gridsteps", default="0.25", help="gridsteps, by comma")
    parser.add_argument(
        "--radii",
        default="3,6,12,paper",
        help="radii in voxels, by comma; paper is 3 h^(-1/2), where DGtal's corrected measures were timed",
    )
    parser.add_argument("--repeats", type=int, default=3)
    return parser.parse_args()


def enter_environment(folder):
    """Makes the virtual environment if it is not there, and goes on in it."""
    folder = pathlib.Path(folder).resolve()
    python = folder / "bin" / "python"
    if pathlib.Path(sys.prefix).resolve() == folder:
        return
    wanted = "\n".join(PACKAGES)
    installed = folder / "installed.txt"
    if not installed.exists() or installed.read_text() != wanted:
        print(f"installing {', '.join(PACKAGES)} into {folder}", file=sys.stderr)
        venv.create(folder, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
        installed.write_text(wanted)
    os.execve(python, [str(python), *sys.argv], {**os.environ, **ONE_THREAD})


def command_seconds(command):
    """Processor time of a command."""
    process = subprocess.Popen(
        [str(part) for part in command], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(process.pid, 0)
    # wait4 took the status that Popen would wait for.
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise SystemExit(f"failed: {' '.join(map(str, command))}")
    return usage.ru_utime + usage.ru_stime


class Truth:
    """H at the closest point of an implicit surface F = 0, F < 0 inside; H is positive on a sphere."""

    def __init__(self, shape):
        import numpy

        self.numpy = numpy
        name, _, parameters = shape.partition(":")
        if name == "sphere":
            radius = float(parameters.removeprefix("radius="))
            self.value = lambda x: (x**2).sum(1) - radius**2
            self.gradient = lambda x: 2 * x
            self.second = lambda x: numpy.full_like(x, 2.0)
        elif name == "goursat":
            self.value = lambda x: 0.015 * (x**4).sum(1) - (x**2).sum(1) - 4
            self.gradient = lambda x: 0.06 * x**3 - 2 * x
            self.second = lambda x: 0.18 * x**2 - 2
        else:
            raise SystemExit(f"no truth for shape '{name}': sphere:radius=R or goursat")

    def mean_curvature(self, points):
        x = self.closest(points)
        g, h = self.gradient(x), self.second(x)
        squared = (g**2).sum(1)
        # The matrix of second derivatives is diagonal for these shapes.
        return (squared * h.sum(1) - (g**2 * h).sum(1)) / (2 * squared**1.5)

    def closest(self, points):
        """Newton's method on x - p + l grad F = 0, F = 0, from a walk along the gradient."""
        numpy = self.numpy
        x = points.copy()
        for _ in range(4):
            g = self.gradient(x)
            x -= (self.value(x) / (g**2).sum(1))[:, None] * g
        g = self.gradient(x)
        multiplier = ((points - x) * g).sum(1) / (g**2).sum(1)
        for _ in range(6):
            g, h = self.gradient(x), self.second(x)
            matrix = numpy.zeros((len(x), 4, 4))
            for a in range(3):
                matrix[:, a, a] = 1 + multiplier * h[:, a]
                matrix[:, a, 3] = matrix[:, 3, a] = g[:, a]
            residual = numpy.column_stack([x - points + multiplier[:, None] * g, self.value(x)])
            step = numpy.linalg.solve(matrix, residual[:, :, None])[:, :, 0]
            x -= step[:, :3]
            multiplier -= step[:, 3]
        return x


class Volume:
    """A digitised shape, as a file, as an array, and as DGtal's surface."""

    def __init__(self, curvox, shape, gridstep, folder):
        import dgtal
        import numpy

        self.gridstep, self.truth = gridstep, Truth(shape)
        self.path = folder / "shape.vol"
        command = [curvox, "shape", shape, "--gridstep", gridstep, "--overwrite", "-o", self.path]
        command_seconds(command)
        stored = self.path.read_bytes()
        header, _, voxels = stored.partition(b"\n.\n")
        fields = dict(line.split(": ") for line in header.decode().splitlines())
        self.dims = [int(fields[axis]) for axis in "XYZ"]
        # x fastest in the file, so the array has axes z, y, x.
        self.voxels = numpy.frombuffer(voxels, numpy.uint8).reshape(self.dims[::-1])
        self.centre = numpy.array([n // 2 for n in self.dims])

        # Later calls change radii alone.
        self.parameters = dgtal.SH3.defaultParameters()
        self.parameters.set("verbose", 0)
        self.image = dgtal.SH3.makeBinaryImage(str(self.path), self.parameters)
        self.space, self.surface, self.cells = self.dgtal_surface()
        self.surfels = len(self.cells)
        k = numpy.array([list(self.space.sKCoords(cell)) for cell in self.cells], float)
        # DGtal numbers voxels from where the header says; both number the same surfels.
        ours = numpy.argwhere(self.voxels)[:, ::-1].min(0)
        self.cell_points = ((k - k.min(0)) / 2 + ours - 0.5 - self.centre) * gridstep

    def dgtal_surface(self):
        """Its space, surface and surfels; in another order each time, for it begins at a random one."""
        from dgtal import SH3

        space = SH3.getKSpace(self.image, self.parameters)
        surface = SH3.makeLightDigitalSurface(self.image, space, self.parameters)
        return space, surface, SH3.getSurfelRange(surface, self.parameters)

    def errors(self, points, found):
        """l2 and linf of the errors of H."""
        numpy = self.truth.numpy
        error = numpy.abs(found - self.truth.mean_curvature(points))
        return numpy.sqrt((error**2).mean()), error.max()


def curvox_cases(curvox, volume, radius, folder):
    """Name, what to time, what to compute errors with."""
    methods = [
        ("curvox, default", []),
        ("curvox, `--method refined`", ["--method", "refined"]),
        ("curvox, `--method paper`", ["--method", "paper"]),
        ("curvox, `--normals ii`", ["--normals", "ii"]),
        ("curvox, `--normals vcm`", ["--normals", "vcm"]),
        ("curvox, `--curvature ii`", ["--curvature", "ii"]),
    ]
    for name, options in methods:
        command = [curvox, "run", volume.path, "--threshold", "1", "--threads", "1"]
        command += ["--radius", f"{radius}vx", "--overwrite", *options]

        def seconds(command=command):
            return command_seconds([*command, "-o", folder / "run"])

        def errors(command=command):
            import numpy

            table = folder / "run.csv"
            command_seconds([*command, "-o", table])
            with open(table, newline="") as rows:
                columns = ["kx", "ky", "kz", "mean_curvature"]
                values = [[float(row[c]) for c in columns] for row in csv.DictReader(rows)]
            values = numpy.array(values)
            # A voxel's centre has Khalimsky coordinate 2 i + 1; lengths of curvox are in voxels here.
            points = ((values[:, :3] - 1) / 2 - volume.centre) * volume.gridstep
            known = numpy.isfinite(values[:, 3])
            return volume.errors(points[known], values[known, 3] / volume.gridstep)

        yield name, seconds, errors


def timed(work):
    """Processor time of a call in this process."""

    def seconds():
        before = time.process_time()
        work()
        return time.process_time() - before

    return seconds


def dgtal_cases(volume, radius):
    from dgtal import SH3
    import numpy

    def parameters():
        volume.parameters.set("r-radius", float(radius))
        volume.parameters.set("R-radius", float(radius * VCM_OFFSET))
        return volume.parameters

    def on_image(estimate):
        return lambda: estimate(volume.image, volume.cells, parameters())

    def errors():
        found = numpy.array(on_image(SH3.getIIMeanCurvatures)())
        return volume.errors(volume.cell_points, found / volume.gridstep)

    yield "DGtal, surface", timed(volume.dgtal_surface), None
    yield "DGtal, II normals", timed(on_image(SH3.getIINormalVectors)), None
    vcm = lambda: SH3.getVCMNormalVectors(volume.surface, volume.cells, parameters())
    yield "DGtal, VCM normals", timed(vcm), None
    yield "DGtal, II mean curvature", timed(on_image(SH3.getIIMeanCurvatures)), errors
    yield "DGtal, II Gaussian curvature", timed(on_image(SH3.getIIGaussianCurvatures)), None
    principal = on_image(SH3.getIIPrincipalCurvaturesAndDirections)
    yield "DGtal, II principal curvatures", timed(principal), None


def mesh_cases(volume):
    import numpy
    import pyvista
    from skimage import filters, measure

    for blur in BLURS:

        def curvature(blur=blur):
            values = volume.voxels.astype(numpy.float32)
            if blur > 0:
                values = filters.gaussian(values, blur)
            vertices, faces, _, _ = measure.marching_cubes(values, 0.5)
            mesh = pyvista.PolyData.from_regular_faces(vertices, faces)
            return vertices, mesh.curvature("mean")

        def errors(curvature=curvature):
            vertices, found = curvature()
            points = (vertices[:, ::-1] - volume.centre) * volume.gridstep
            # Which way the faces turn decides the sign; they all turn the same.
            errors = [volume.errors(points, s * found / volume.gridstep) for s in (1, -1)]
            return min(errors)

        bits = "bits" if blur == 0 else f"bits, blur {blur:g} vx"
        yield f"marching cubes of {bits}, PyVista", timed(curvature), errors


def beside(medians, name, us):
    """How many times as long as the run of curvox that gives the same."""
    options = BESIDE.get(name, "default" if name.startswith("marching") else None)
    return f"{us / medians['curvox, ' + options]:.1f}, {options}" if options else ""


def median(values):
    values = sorted(values)
    half = len(values) // 2
    return values[half] if len(values) % 2 else (values[half - 1] + values[half]) / 2


def main():
    options = arguments()
    enter_environment(options.venv)
    curvox = pathlib.Path(options.curvox).resolve()
    print(f"{', '.join(PACKAGES)}; medians of {options.repeats}.\n")
    print("| shape | h | surfels | radius | program | us a surfel | times that of curvox | error of H, l2 | linf |")
    print("|---|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        for shape in options.shapes.split(","):
            for gridstep in map(float, options.gridsteps.split(",")):
                paper = 3 / gridstep**0.5
                asked = [paper if r == "paper" else float(r) for r in options.radii.split(",")]
                radii = sorted({round(radius, 4) for radius in asked})
                volume = Volume(curvox, shape, gridstep, folder)
                meshes = list(mesh_cases(volume))
                for _, seconds, _ in meshes:
                    # Their first call loads more of their packages.
                    seconds()
                for radius in radii:
                    cases = list(curvox_cases(curvox, volume, f"{radius:g}", folder))
                    cases += dgtal_cases(volume, radius)
                    if radius == radii[-1]:
                        # They have no radius.
                        cases += meshes
                    times = [[] for _ in cases]
                    for _ in range(options.repeats):
                        for (_, seconds, _), taken in zip(cases, times):
                            taken.append(seconds() * 1e6 / volume.surfels)
                    medians = {name: median(taken) for (name, _, _), taken in zip(cases, times)}
                    start = f"| {shape} | {gridstep:g} | {volume.surfels}"
                    for name, _, errors in cases:
                        shown = "" if name.startswith("marching") else f"{radius:g}"
                        l2, linf = errors() if errors else (None, None)
                        cells = [f"{e:.4f}" if e is not None else "" for e in (l2, linf)]
                        over = beside(medians, name, medians[name])
                        print(f"{start} | {shown} | {name} | {medians[name]:.2f} | {over} | {' | '.join(cells)} |")
                    for name, parts in SUMS.items():
                        us = sum(medians[part] for part in parts)
                        over = beside(medians, name, us)
                        print(f"{start} | {radius:g} | {name} | {us:.2f} | {over} | | |")
                    known = DGTAL_CORRECTED.get(gridstep)
                    if known and shape == "goursat" and abs(radius - paper) < 1e-3:
                        over = beside(medians, CORRECTED, known)
                        print(f"{start} | {radius:g} | {CORRECTED} | {known} | {over} | | |")
                    sys.stdout.flush()


if __name__ == "__main__":
    main()
