"""Prints the report of a run of the benchmarks in Markdown: report.py RESULTS.

RESULTS holds speed_SUBJECT.json, written by Google Benchmark, and the tables and plots of accuracy and layers.
"""

import collections
import csv
import json
import pathlib
import statistics
import subprocess
import sys

PAPER_MS = {"occupancy grid": 16.34, "Gaussian process": 142.60, "spline": 11.48}
PAPER_WORKLOAD = "simulated_360_beams_3.5_m"
PEER_PACKAGES = ["libmrpt-maps-dev", "liboctomap-dev", "libbenchmark-dev"]
TILE_BYTES = 2048
ACCURACY_TABLES = [
    "fig3", "fig5", "hits", "logs", "defaults", "door", "gp", "door_votes", "split_drives_mean", "surface",
    "halves", "stretches", "strangers",
]  # fmt: skip


class Speed:
    """Medians over the repetitions of each benchmark."""

    def __init__(self, paths):
        self.runs = collections.defaultdict(list)
        self.order = {}  # as the benchmarks were registered, whatever order they ran in
        for place, path in enumerate(sorted(paths, key=lambda p: p.stat().st_mtime)):
            with open(path, encoding="utf-8") as file:
                data = json.load(file)
            self.context = data["context"]
            for run in data["benchmarks"]:
                if run["run_type"] == "iteration" and not run.get("error_occurred"):
                    name = run["run_name"].removesuffix("/real_time")
                    self.runs[name].append(run)
                    self.order[name] = (place, run["family_index"])

    def median(self, name, field):
        """Of a field of a benchmark; None where either is not there."""
        values = [run[field] for run in self.runs.get(name, []) if field in run]
        return statistics.median(values) if values else None

    def seconds(self, name):
        """CPU time per item; wall time for what is measured in wall time."""
        rate = self.median(name, "items_per_second")
        return 1 / rate if rate else None

    def subjects(self, group):
        """Second parts of the names in a group, in order."""
        return list(dict.fromkeys(n.split("/")[1] for n in self.names() if n.startswith(group + "/")))

    def names(self):
        """Of all benchmarks, in order."""
        return sorted(self.runs, key=self.order.get)


def ratio(a, b):
    """a / b, or None where one of them is missing."""
    return a / b if a and b else None


def number(value, digits=3):
    """With so many significant digits; a dash for None."""
    if value is None:
        return "-"
    return f"{value:.{digits}g}" if abs(value) < 10**digits else f"{value:,.0f}"


def table(header, rows):
    """A Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def words(name):
    """The name of a benchmark as a heading."""
    return name.replace("_", " ")


# ---------------------------------------------------------------- aims


def insertion_aims(speed):
    """Against MRPT, OctoMap and the limit, by workload."""
    for workload in speed.subjects("insertion"):
        base = f"insertion/{workload}/"
        own = speed.seconds(base + "splinemap")
        mrpt = speed.seconds(base + "mrpt_simple_beams")
        octomap = speed.seconds(base + "octomap")
        limits = [speed.seconds(base + "limit_of_splinemap" + how) for how in ("", "_in_vectors")]
        limit = min(limits) if all(limits) else None
        name = words(workload)
        yield f"a scan of {name}, in times of MRPT's simple beams", ratio(own, mrpt), "x", 1.0
        for kernel, most in (("avx2", 1.0), ("sse4", 1.3), ("plain", 1.3)):
            slower = ratio(speed.seconds(base + f"splinemap_{kernel}"), mrpt)
            if slower:
                yield f"the same with the {kernel} kernel", slower, "x", most
        yield "the same, in times of OctoMap's", ratio(own, octomap), "x", 1 / 40
        yield "the same, in times of the limit", ratio(own, limit), "x", 3.0


def query_aims(speed):
    """Random points against loads, and along a path."""
    limit = speed.seconds("queries/random/limit")
    for kind, most in (("single", 6.0), ("batched", 1.5)):
        value = ratio(speed.seconds(f"queries/random/{kind}"), limit)
        yield f"random points, {kind}, in times of the loads alone", value, "x", most
    for kind in ("single", "reader", "batched"):
        path = speed.seconds(f"queries/path/{kind}")
        yield f"points along a path, {kind}", path and path * 1e9, "ns", 15


def other_aims(speed, results):
    """Merging, growth, memory, end to end, requests, distances."""
    for layers in (8, 32):
        bandwidth = ratio(
            speed.median(f"merging/{layers}_layers/memcpy", "bytes_per_second"),
            speed.median(f"merging/{layers}_layers/splinemap", "bytes_per_second"),
        )
        yield f"the sum of {layers} layers, in times of memcpy", bandwidth, "x", 1.2
    for what in ("scan", "scan_and_snapshot"):
        yield f"{words(what)}: the most over the least of all sizes of the map", growth(speed, what), "x", 1.1
    sizes = speed.subjects("growth")
    memory = max(speed.median(f"growth/{s}/scan", "bytes_per_tile") or 0 for s in sizes) if sizes else 0
    yield "memory per tile, in times of 2 KiB", ratio(memory, TILE_BYTES), "x", 1.25
    for drive in speed.subjects("end_to_end"):
        build, peer = (f"end_to_end/{drive}/{program}" for program in ("splinemap_build", "mrpt_build"))
        wall = ratio(speed.median(build, "real_time"), speed.median(peer, "real_time"))
        yield f"`splinemap build` of {words(drive)}, in times of MRPT's with its reading", wall, "x", 1.2
    for points, value in requests(results / "serving.json"):
        yield f"{points} by RPC, in times of an echo", value, "x", 1.3
    yield "a scan's change to DistanceField, in times of dynamicEDT3D's update", field(results), "x", 1.0


def requests(path):
    """Number of points and median time over that of an echo of the same bytes."""
    if not path.exists():
        return
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    times = {(r["workload"], r["competitor"]): r["value"] for r in rows if "median" in r["unit"]}
    for workload, competitor in times:
        if competitor == "MapClient asks splinemapd":
            echo = times.get((workload, "LCM echo of the same bytes"))
            yield workload, ratio(times[workload, competitor], echo)


def field(results):
    """What asking_bench says of the field's update; None where it was not run."""
    path = results / "asking.txt"
    if not path.exists():
        return None
    for line in path.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if cells[0] == "a scan's change to DistanceField" and cells[2].startswith("dynamicEDT3D"):
            return ratio(1, float(cells[-1]))
    return None


def growth(speed, what):
    """The greatest cost over the least, over the sizes of the map."""
    costs = [speed.seconds(f"growth/{size}/{what}") for size in speed.subjects("growth")]
    return max(costs) / min(costs) if len(costs) > 1 and all(costs) else None


def aims(speed, results):
    """Each aim with its figure, and which are missed."""
    rows = []
    for aim, value, unit, most in [
        *insertion_aims(speed), *query_aims(speed), *other_aims(speed, results)
    ]:  # fmt: skip
        verdict = "not measured" if value is None else "reached" if value <= most else "**missed**"
        figure = number(value) + ("" if value is None else f" {unit}")
        rows.append([aim, figure, f"{number(most)} {unit}", verdict])
    return "## Aims\n\n" + table(["aim", "figure", "at most", ""], rows)


# ---------------------------------------------------------------- tables


def insertion(speed):
    """Microseconds per scan, and splinemap's time over each."""
    workloads = speed.subjects("insertion")
    names = [n.split("/")[2] for n in speed.names() if n.startswith("insertion/")]
    rows = []
    for competitor in dict.fromkeys(names):
        row = [words(competitor)]
        for workload in workloads:
            time = speed.seconds(f"insertion/{workload}/{competitor}")
            own = speed.seconds(f"insertion/{workload}/splinemap")
            row.append(f"{number(time and time * 1e6)} ({number(ratio(time, own))} x)")
        rows.append(row)
    points = ["control points that a scan changes"]
    for workload in workloads:
        points.append(
            number(speed.median(f"insertion/{workload}/limit_of_splinemap", "points_per_scan"), 4)
        )
    return (
        "## Scan insertion\n\n"
        "From a scan in memory to committed tiles, into a fresh map: microseconds per scan, and in "
        "brackets over splinemap's. The limit reads, adds to and writes each control point that the "
        "scan changes once; in vectors, each half row of a tile.\n\n"
        + table([""] + [words(w) for w in workloads], rows + [points])
    )


def table_one(speed, results):
    """The paper's Table I, row by row."""
    base = f"insertion/{PAPER_WORKLOAD}/"
    gp_ms = gaussian_process_ms(results / "gp.csv")
    rows = [
        ["occupancy grid (here MRPT, simple beams)", "occupancy grid", speed.seconds(base + "mrpt_simple_beams")],
        ["Gaussian process (here one plain fit, shared out to its scans)", "Gaussian process", gp_ms and gp_ms / 1e3],
        ["spline (here splinemap)", "spline", speed.seconds(base + "splinemap")],
        ["spline, the paper's update in C++", "spline", speed.seconds(base + "paper_in_double")],
    ]  # fmt: skip
    cells = [
        [title, number(PAPER_MS[row], 4), number(s and s * 1e3), number(s and PAPER_MS[row] / (s * 1e3))]
        for title, row, s in rows
    ]
    return (
        "## Table I of the paper\n\n"
        "Milliseconds per scan of the paper's 360 beams and 3.5 m; the paper's are Python on an "
        "i5-3317U, in a simulation of its own.\n\n"
        + table(["", "paper, ms", "here, ms", "times faster"], cells)
    )


def gaussian_process_ms(path):
    """One fit to points drawn from as few scans as there is a row for, by scan."""
    if not path.exists():
        return None
    with open(path, encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["method"].startswith("GP")]
    if not rows:
        return None
    row = min(rows, key=lambda r: int(r["scans"]))
    return float(row["map_ms"]) / int(row["scans"])


def queries(speed):
    """Nanoseconds per point."""
    rows = [
        [words(name.removeprefix("queries/")), number(speed.seconds(name) * 1e9)]
        for name in speed.names()
        if name.startswith("queries/")
    ]
    return (
        "## Queries\n\nValue and gradient, nanoseconds per point. The limit loads the control "
        "points of the same random points through a flat array of pointers, and computes nothing. "
        "Points of a path are 1 cm apart.\n\n" + table(["", "ns"], rows)
    )


def merging(speed):
    """Bandwidth."""
    rows = []
    for name in speed.names():
        if name.startswith("merging/"):
            rate = speed.median(name, "bytes_per_second")
            rows.append([words(name.removeprefix("merging/")), number(rate / 1e9)])
    return "## Merged view\n\nBytes read and written, GB/s.\n\n" + table(["", "GB/s"], rows)


def growing(speed):
    """By the size of the map."""
    rows = []
    for size in speed.subjects("growth"):
        base = f"growth/{size}/"
        rows.append(
            [number(speed.median(base + "scan", "tiles"), 4)]
            + [number(speed.seconds(base + what) * 1e6) for what in ("scan", "scan_and_snapshot")]
            + [number(speed.median(base + "scan", "bytes_per_tile"), 4)]
        )
    return "## Size of the map\n\n" + table(
        ["tiles", "scan, us", "scan and snapshot, us", "bytes per tile"], rows
    )


def program(speed):
    """The command line tool beside a program that maps the same log into MRPT's grid."""
    rows = []
    for drive in speed.subjects("end_to_end"):
        build, peer = (f"end_to_end/{drive}/{program}" for program in ("splinemap_build", "mrpt_build"))
        wall_s, peer_wall_s = (speed.median(name, "real_time") for name in (build, peer))
        cpu_s, peer_cpu_s = (speed.median(name, "cpu_s") for name in (build, peer))
        if not (wall_s and peer_wall_s):
            continue
        scans = speed.median(build, "items_per_second") * wall_s / 1e9
        rows.append([
            words(drive), number(scans, 6), number(wall_s / 1e9), number(cpu_s),
            number(ratio(wall_s, peer_wall_s)), number(ratio(cpu_s, peer_cpu_s)),
        ])  # fmt: skip
    if not rows:
        return "## `splinemap build`\n\nNot measured: the recorded drives are not there.\n"
    header = ["log", "scans", "wall, s", "processor, s", "wall, in MRPT's", "processor, in MRPT's"]
    return "## `splinemap build`, the whole process\n\n" + table(header, rows)


def accuracy(results):
    """The tables and plots of the programs accuracy and layers as they are."""
    parts = []
    for name in ACCURACY_TABLES:
        path = results / f"{name}.csv"
        if not path.exists():
            continue
        with open(path, encoding="utf-8") as file:
            rows = list(csv.reader(file))
        parts.append(f"### {name}\n\n" + table(rows[0], rows[1:]))
    parts += [f"![{p.stem}](results/{p.name})\n" for p in sorted(results.glob("*.png"))]
    return "## Accuracy\n\n" + "\n".join(parts) if parts else ""


# ---------------------------------------------------------------- machine


def first_line(*command):
    """Of what a command prints."""
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    return (result.stdout.splitlines() or ["unknown"])[0]


def machine(speed):
    """What the figures hold for."""
    with open("/proc/cpuinfo", encoding="utf-8") as file:
        model = next((l.split(":")[1].strip() for l in file if l.startswith("model name")), "unknown")
    load = ", ".join(str(round(x, 1)) for x in speed.context.get("load_avg", []))
    rows = [
        ["processor", f"{model}, {speed.context['num_cpus']} cores"],
        ["instructions", speed.context.get("instructions", "unknown")],
        ["load average before", load],
        ["compiler", first_line("c++", "--version")],
        ["date", speed.context["date"]],
        ["commit", first_line("git", "describe", "--always", "--dirty")],
    ]
    for package in PEER_PACKAGES:
        rows.append([package, first_line("dpkg-query", "-W", "-f", "${Version}\n", package)])
    return "## Machine\n\n" + table(["", ""], rows)


def main():
    """Prints all of it."""
    results = pathlib.Path(sys.argv[1])
    speed = Speed(results.glob("speed_*.json"))
    repetitions = max(len(runs) for runs in speed.runs.values())
    print(
        f"# Benchmarks\n\nMedians of {repetitions} interleaved repetitions, one thread; processor "
        "time where nothing else is said.\n"
    )
    if "quick" in speed.context:
        print("A quick run to see that everything works: its figures say nothing.\n")
    print(machine(speed))
    print(aims(speed, results))
    print(insertion(speed))
    print(table_one(speed, results))
    for section in (queries, merging, growing, program):
        print(section(speed))
    print(accuracy(results))


if __name__ == "__main__":
    main()
