#!/usr/bin/python3
"""Draws the tables that `accuracy` wrote: plot.py DIR. Leaves PNG files beside them."""

import csv
import pathlib
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np


def read(directory, name):
    """Rows of a table as dictionaries, numbers as such; none where the table is not there."""
    path = directory / name
    if not path.exists():
        return []
    with path.open() as file:
        return [{k: number(v) for k, v in row.items()} for row in csv.DictReader(file)]


def number(text):
    try:
        return float(text)
    except ValueError:
        return text


def distinct(rows, key):
    return list(dict.fromkeys(row[key] for row in rows))


def save(figure, path):
    figure.savefig(path, dpi=110, bbox_inches="tight")
    plt.close(figure)


def style(method):
    """The same look for the same kind of map in every plot."""
    kinds = {"grid": "tab:gray", "MRPT": "tab:brown", "spline": "tab:blue"}
    color = next((c for kind, c in kinds.items() if method.startswith(kind)), "tab:green")
    if "bilinear" in method:
        color = "tab:orange"
    if "bicubic" in method:
        color = "tab:red"
    if "samples" in method:
        color = "tab:cyan"
    if "double" in method:
        color = "black"
    if "signed distance" in method:
        color = "tab:purple"
    return color


def fig3(directory):
    rows = read(directory, "fig3.csv")
    if not rows:
        return
    figure, axes = plt.subplots(figsize=(8, 5))
    for method in distinct(rows, "method"):
        mine = [row for row in rows if row["method"] == method]
        axes.plot([r["half_side_m"] for r in mine], [r["mapping_error"] for r in mine],
                  "x--" if "double" in method else "o-", color=style(method), label=method)
    axes.set_yscale("symlog", linthresh=0.1)
    axes.set_xlabel("half side of the square room, m (cells and knots 0.1 m)")
    axes.set_ylabel("mapping error (37) over 360 hits")
    axes.set_title("Fig. 3: walls between the centres of cells, no noise")
    axes.grid(alpha=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    save(figure, directory / "fig3.png")


def fig5(directory):
    rows = read(directory, "fig5.csv")
    if not rows:
        return
    methods = distinct(rows, "method")
    sigmas = distinct(rows, "range_sigma_m")
    figure, axes = plt.subplots(figsize=(9, 5))
    width = 0.8 / len(methods)
    for n, method in enumerate(methods):
        mine = [row for row in rows if row["method"] == method]
        boxes = [{"whislo": r["least"], "q1": r["quartile"], "med": r["median"],
                  "q3": r["quartile3"], "whishi": r["greatest"]} for r in mine]
        places = [k + (n - (len(methods) - 1) / 2) * width for k in range(len(mine))]
        axes.bxp(boxes, positions=places, widths=0.8 * width, showfliers=False, patch_artist=True,
                 boxprops={"facecolor": style(method), "edgecolor": style(method)},
                 medianprops={"color": "white"}, whiskerprops={"color": style(method)},
                 capprops={"color": style(method)})
        axes.plot([], [], "s", color=style(method), label=method)
    axes.set_xticks(range(len(sigmas)))
    axes.set_xticklabels([f"{sigma:g}" for sigma in sigmas])
    axes.set_yscale("log")
    axes.set_xlabel("standard deviation of the range, m (cells and knots 0.1 m)")
    axes.set_ylabel("mapping error (37) over 360 hits")
    axes.set_title("Fig. 5: circle of 2 m; boxes: quartiles, whiskers: all runs")
    axes.grid(alpha=0.3, axis="y")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncol=3)
    save(figure, directory / "fig5.png")


def maps(directory):
    rows = read(directory, "maps.csv")
    if not rows:
        return
    scenes, methods = distinct(rows, "scene"), distinct(rows, "method")
    figure, axes = plt.subplots(len(scenes), len(methods), squeeze=False, layout="constrained",
                                figsize=(3 * len(methods), 3.1 * len(scenes)))
    image = None
    for row in rows:
        panel = axes[scenes.index(row["scene"])][methods.index(row["method"])]
        values = np.loadtxt(directory / row["file"], delimiter=",")
        image = panel.imshow(values, origin="lower", extent=[-2.4, 2.4, -2.4, 2.4],
                             cmap="gray_r", vmin=-1, vmax=1)
        panel.set_title(row["method"])
        panel.set_xlabel("x, m")
        if row["method"] == methods[0]:
            panel.set_ylabel(f"{row['scene']}\ny, m")
    figure.colorbar(image, ax=axes, label="free -1 .. 1 occupied", shrink=0.7)
    save(figure, directory / "maps.png")


def logs(directory):
    rows = read(directory, "logs.csv")
    if not rows:
        return
    drives = distinct(rows, "drive")
    measures = {"auc": "AUC, all free points", "auc_near": "AUC, free points near hits",
                "log_likelihood": "mean log-likelihood"}
    figure, axes = plt.subplots(len(measures), len(drives), squeeze=False, layout="constrained",
                                figsize=(4.6 * len(drives), 3.6 * len(measures)))
    for column, drive in enumerate(drives):
        for line, (measure, label) in enumerate(measures.items()):
            draw_drive(axes[line][column], [r for r in rows if r["drive"] == drive], measure)
            axes[line][column].set_ylabel(label)
        axes[0][column].set_title(drive)
        axes[-1][column].set_xlabel("bytes of tiles or cells (points: 0.2 .. 0.05 m)")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", bbox_to_anchor=(0.5, 0), ncol=5)
    save(figure, directory / "logs.png")


def draw_drive(axes, rows, measure):
    looks = ["-", "--", ":", "-."]
    used = {}
    for method in distinct(rows, "method"):
        mine = [row for row in rows if row["method"] == method]
        color = style(method)
        look = looks[used.setdefault(color, 0) % len(looks)]
        used[color] += 1
        axes.plot([r["bytes"] for r in mine], [r[measure] for r in mine], "o" + look,
                  color=color, markersize=3, linewidth=1.2, label=method)
    axes.set_xscale("log")
    axes.grid(alpha=0.3)


def door(directory):
    rows = read(directory, "door.csv")
    if not rows:
        return
    methods, befores = distinct(rows, "method"), distinct(rows, "scans_before")
    figure, axes = plt.subplots(1, 2, sharey=True, layout="constrained", figsize=(11, 8))
    measures = {"scans_until_closed": "scans until a closed door is occupied",
                "scans_until_open": "scans until an opened door is free"}
    for panel, (measure, label) in zip(axes, measures.items()):
        for k, before in enumerate(befores):
            mine = [row for row in rows if row["scans_before"] == before]
            panel.barh([methods.index(r["method"]) + 0.26 * (k - 1) for r in mine],
                       [max(r[measure], 0.5) for r in mine], height=0.24,
                       label=f"after {before:g} scans")
        panel.set_xscale("log")
        panel.set_xlim(left=0.5)
        panel.set_xlabel(label)
        panel.grid(alpha=0.3, axis="x")
    axes[0].set_yticks(range(len(methods)))
    axes[0].set_yticklabels(methods)
    axes[0].invert_yaxis()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", bbox_to_anchor=(0.5, 0), ncol=3)
    save(figure, directory / "door.png")


def levels(directory):
    """What each map takes for an obstacle, beside the outlines of the things themselves."""
    rows = read(directory, "level.csv")
    if not rows:
        return
    methods, scenes = distinct(rows, "method"), distinct(rows, "scene")
    figure, axes = plt.subplots(len(scenes), len(methods), squeeze=False, layout="constrained",
                                figsize=(3.2 * len(methods), 2.6 * len(scenes)))
    for line, scene in enumerate(scenes):
        for column, method in enumerate(methods):
            mine = [r for r in rows if r["method"] == method and r["scene"] == scene]
            xs, ys = distinct(mine, "x_m"), distinct(mine, "y_m")
            image = np.reshape([r["is_obstacle"] for r in mine], (len(ys), len(xs)))
            panel = axes[line][column]
            panel.imshow(image, origin="lower", extent=[xs[0], xs[-1], ys[0], ys[-1]],
                         cmap="Greys", vmin=0, vmax=1.6)
            outline(panel, scene)
            panel.set_xlim(xs[0], xs[-1])
            panel.set_ylim(ys[0], ys[-1])
            if line == 0:
                panel.set_title(method)
        axes[line][0].set_ylabel(f"{scene}; m")
    save(figure, directory / "levels.png")


def outline(panel, scene):
    """The door of 0.8 m in a wall of 12 cm, and the pole of 5 cm, of the program `surface`."""
    look = {"fill": False, "edgecolor": "tab:red", "linewidth": 1.2}
    if scene == "door":
        panel.add_patch(plt.Rectangle((0.4, 0), 4, 0.12, **look))
        panel.add_patch(plt.Rectangle((-4.4, 0), 4, 0.12, **look))
    else:
        panel.add_patch(plt.Circle((0, 0), 0.025, **look))


def main():
    directory = pathlib.Path(sys.argv[1])
    for draw in (fig3, fig5, maps, logs, door, levels):
        draw(directory)


if __name__ == "__main__":
    main()
