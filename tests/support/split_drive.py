#!/usr/bin/env python3
"""Splits the scans of an LCM log among robots that see the same poses.

usage: split_drive.py LOG SCAN_CHANNEL ROBOTS PREFIX

Writes PREFIX1.lcmlog .. PREFIXn.lcmlog. Each has every message that is no scan, and of the scans those
of its stretches: the drive is cut into 3 n of them, which the robots take in turn.
"""
import struct
import sys


def events(data):
    at = 0
    while at < len(data):
        name_size, size = struct.unpack_from(">II", data, at + 20)
        end = at + 28 + name_size + size
        yield data[at + 28 : at + 28 + name_size].decode(), data[at:end]
        at = end


def main():
    log, scan_channel, robots, prefix = sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4]
    drive = list(events(open(log, "rb").read()))
    scans = sum(channel == scan_channel for channel, _ in drive)
    parts = [bytearray() for _ in range(robots)]
    seen = 0
    for channel, event in drive:
        if channel == scan_channel:
            parts[3 * robots * seen // scans % robots] += event
            seen += 1
        else:
            for part in parts:
                part += event
    for k, part in enumerate(parts, 1):
        with open(f"{prefix}{k}.lcmlog", "wb") as out:
            out.write(part)


main()
