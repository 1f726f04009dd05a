// What the server sends in a frame: uint32 LE n, n bytes of JSON, the bodies of the tiles.
// Sections that did not change since the frame before are absent.

import { inflate } from "./inflate";

export const kTileSide = 32;
const kTileBytes = 2 * kTileSide * kTileSide;

export interface Box {
  x0_m: number;
  y0_m: number;
  x1_m: number;
  y1_m: number;
}

export interface MapInfo {
  source: "bus" | "fleet" | "file";
  name: string;
  knot_interval_m: number;
  min_log_odds: number;
  max_log_odds: number;
  revision: number;
  tiles: number;
  bounds: Box | null; // null: nothing mapped yet
  allows_commands: boolean;
  is_caught_up: boolean;
  problem: string; // of the bus or the fleet
  version: string;
  refused: string[];
}

// Of a file that keeps scans: the map can be shown as it was at the time of each.
export interface MapTimes {
  first_utime: number; // of the scans, in us
  last_utime: number;
  shown_utime: number | null; // null: now
  wanted_utime: number | null; // the same, but while that map is made
  problem: string; // why it cannot be made
}

export interface Layer {
  key: string;
  name: string;
  state: "own" | "live" | "stale" | "gone" | "removed" | "file";
  is_muted: boolean;
  is_low_weight: boolean;
  placement: { x_m: number; y_m: number; yaw_rad: number }; // of its frame in the map's
  is_approximate: boolean; // resampled, since its knots are not those of the map
  tiles: number;
  caught_up: boolean;
  staleness_ms: number | null; // null: never in sync
  heard_s_ago: number; // -1: not yet
  contradicted: number | null; // 0..1; null and -1: cannot be told
  bounds: Box | null;
}

export interface Count {
  count: number;
}

export interface Daemon {
  key: string;
  name: string;
  version: string;
  uptime_s: number;
  scans_received: number;
  scans_mapped: number;
  newest_scan_age_s: number;
  messages_dropped: number;
  drops: (Count & { reason: string })[];
  problems: (Count & { name: string })[];
  last_problem: string;
  heard_s_ago: number;
  revision: number;
  saved_revision: number;
}

export interface Pose {
  channel: string;
  x_m: number;
  y_m: number;
  yaw_rad: number;
  heard_s_ago: number;
}

export interface Scan {
  channel: string;
  sensor: { x_m: number; y_m: number };
  points_m: number[]; // x, y, x, y, ..
  heard_s_ago: number;
}

export interface Path {
  channel: string;
  points_m: number[]; // x, y, x, y, ..
  heard_s_ago: number;
}

interface TileSection {
  level: number;
  surfaces: string[];
  list: [number, number, number, number, number][]; // surface index, tx, ty, bytes, utime in ms
  is_complete: boolean;
}

export interface TileUpdate {
  surface: number; // index into `surfaces`
  tx: number;
  ty: number;
  changed_utime_ms: number;
  points: Int16Array | null; // null: the tile is gone
}

export interface TileNews {
  level: number;
  surfaces: string[];
  updates: TileUpdate[];
  is_complete: boolean;
}

interface FrameJson {
  frame: number;
  map?: MapInfo;
  times?: MapTimes;
  layers?: Layer[];
  daemons?: Daemon[];
  poses?: Pose[];
  scans?: Scan[];
  paths?: Path[];
  tiles?: TileSection;
}

export interface Frame extends Omit<FrameJson, "tiles"> {
  tiles?: TileNews;
}

// Throws an Error where the frame is cut short or a body is not a tile.
export function decodeFrame(buffer: ArrayBuffer): Frame {
  const length = new DataView(buffer).getUint32(0, true);
  const json = new TextDecoder().decode(new Uint8Array(buffer, 4, length));
  const { tiles, ...rest } = JSON.parse(json) as FrameJson;
  if (!tiles) return rest;
  return { ...rest, tiles: decodeTiles(tiles, new Uint8Array(buffer, 4 + length)) };
}

function decodeTiles(section: TileSection, bodies: Uint8Array): TileNews {
  let at = 0;
  const updates = section.list.map(([surface, tx, ty, bytes, changed_utime_ms]): TileUpdate => {
    if (at + bytes > bodies.length) throw new Error("a frame is cut short");
    const body = bodies.subarray(at, (at += bytes));
    return { surface, tx, ty, changed_utime_ms, points: bytes === 0 ? null : decodePoints(body) };
  });
  const { level, surfaces, is_complete } = section;
  return { level, surfaces, updates, is_complete };
}

// The machines that have browsers are little-endian, as the wire is.
function decodePoints(body: Uint8Array): Int16Array {
  return new Int16Array(inflate(body, kTileBytes).buffer);
}
