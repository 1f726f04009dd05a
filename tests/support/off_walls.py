#!/usr/bin/env python3
"""off_walls.py MAP.csv: of a map of the room that the cases of the shared data folder show, prints how
many points of `splinemap export --format csv` are occupied, and how many of them are more than 15 cm
from every wall."""

import csv
import sys

WALLS = [((0, 0), (10, 0)), ((10, 0), (10, 6)), ((10, 6), (0, 6)), ((0, 6), (0, 0)), ((4, 0), (4, 2))]


def distance(x, y, wall):
    (x0, y0), (x1, y1) = wall
    px, py = min(max(x, min(x0, x1)), max(x0, x1)), min(max(y, min(y0, y1)), max(y0, y1))
    return ((x - px) ** 2 + (y - py) ** 2) ** 0.5


occupied = off = 0
with open(sys.argv[1], newline="") as file:
    for row in csv.DictReader(file):
        if float(row["log_odds"]) <= 0:
            continue
        occupied += 1
        x, y = float(row["x_m"]), float(row["y_m"])
        off += min(distance(x, y, wall) for wall in WALLS) > 0.15
print(occupied, off)
