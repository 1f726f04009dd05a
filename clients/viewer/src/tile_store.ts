import { Box, Frame, TileNews, TileUpdate, kTileSide } from "./frame";

// All tiles together, of all levels and surfaces: 25 MB here, and 33 MB in the atlas.
export const kMaxTiles = 12_000;

// A frame that comes first after a view was asked for may answer the view before; when nothing
// follows it, it was the answer.
const kSettle_ms = 400;

export interface Tile {
  tx: number;
  ty: number;
  points: Int16Array;
  changed_utime_ms: number;
  isConfirmed: boolean; // in the view ever since it was last sent, so that it cannot be outdated
  isDirty: boolean; // it or a neighbour is not in the atlas as it is now
  slot: number; // in the atlas, -1: none
}

// The tiles of one surface, "sum" or a layer, at one level.
export class TileSet {
  readonly tiles = new Map<number, Tile>();

  find(tx: number, ty: number): Tile | undefined {
    return this.tiles.get(keyOf(tx, ty));
  }
}

// What was asked for at once: a level of some surfaces.
export class Generation {
  readonly sets: TileSet[];

  constructor(
    readonly level: number,
    readonly surfaces: string[],
  ) {
    this.sets = surfaces.map(() => new TileSet());
  }

  holds(level: number, surfaces: string[]): boolean {
    return level === this.level && surfaces.join("\n") === this.surfaces.join("\n");
  }

  tileCount(): number {
    return this.sets.reduce((sum, set) => sum + set.tiles.size, 0);
  }
}

// Poses of the wire are within 2^28 knots, so tiles are within 2^24.
function keyOf(tx: number, ty: number): number {
  return (tx + 2 ** 25) * 2 ** 26 + (ty + 2 ** 25);
}

// The tiles that the page has. The generation before stays until the current one is complete, so
// that nothing flashes when the level changes.
export class TileStore {
  current = new Generation(0, []);
  previous: Generation | null = null;
  isComplete = false;
  onFree: (slot: number) => void = () => {};
  private box: Box | null = null; // what was asked for, in tiles of the current level
  private framesSinceAsked = 0;
  private isNewGeneration = false;
  private settling = 0;

  constructor(private readonly onChange: () => void) {}

  // Oldest first, as they are drawn.
  generations(): Generation[] {
    return this.previous ? [this.previous, this.current] : [this.current];
  }

  tileCount(): number {
    return this.generations().reduce((sum, generation) => sum + generation.tileCount(), 0);
  }

  forget(): void {
    for (const generation of this.generations()) this.drop(generation);
    this.current = new Generation(0, []);
    this.previous = null;
    this.isComplete = false;
    this.box = null;
  }

  // The server was asked for a view. `box` is in tiles of the level; tiles further than one from it
  // are none that the server keeps up to date.
  ask(level: number, surfaces: string[], box: Box): void {
    clearTimeout(this.settling);
    this.isNewGeneration = !this.current.holds(level, surfaces);
    if (this.isNewGeneration) this.begin(level, surfaces);
    this.isComplete = false;
    this.framesSinceAsked = 0;
    this.box = box;
    this.forEachTile((tile) => {
      if (!isInBox(tile, box, 1)) tile.isConfirmed = false;
    });
  }

  take(frame: Frame): void {
    ++this.framesSinceAsked;
    const news = frame.tiles;
    if (!news) return;
    const holds = (g: Generation) => g.holds(news.level, news.surfaces);
    const generation = holds(this.current) ? this.current : this.generations().find(holds);
    if (!generation) return;
    for (const update of news.updates) this.apply(generation, update);
    if (generation === this.current) this.noteCompleteness(news);
    this.onChange();
  }

  private begin(level: number, surfaces: string[]): void {
    // What is on the screen is the last complete one, or the first of all.
    if (this.isComplete || !this.previous) {
      if (this.previous) this.drop(this.previous);
      this.previous = this.current;
    } else {
      this.drop(this.current);
    }
    this.current = new Generation(level, surfaces);
  }

  private noteCompleteness(news: TileNews): void {
    clearTimeout(this.settling);
    if (!news.is_complete) {
      this.isComplete = false;
    } else if (this.isNewGeneration || this.framesSinceAsked > 1) {
      this.finish();
    } else {
      this.settling = window.setTimeout(() => this.finish(), kSettle_ms);
    }
  }

  private finish(): void {
    this.isComplete = true;
    if (this.previous) this.drop(this.previous);
    this.previous = null;
    const isCrowded = this.tileCount() > kMaxTiles / 2;
    for (const set of this.current.sets) {
      for (const tile of set.tiles.values()) {
        const isGone = this.box !== null && isInBox(tile, this.box, 0);
        if (!tile.isConfirmed && (isGone || isCrowded)) this.remove(set, tile);
      }
    }
    this.onChange();
  }

  private apply(generation: Generation, update: TileUpdate): void {
    const set = generation.sets[update.surface];
    if (!set) return;
    const { tx, ty, points, changed_utime_ms } = update;
    const tile = set.find(tx, ty);
    if (!points) {
      if (tile) this.remove(set, tile);
      return;
    }
    if (tile) Object.assign(tile, { points, changed_utime_ms, isConfirmed: true });
    else if (!this.add(set, update, points)) return;
    markDirty(set, tx, ty);
  }

  private add(set: TileSet, update: TileUpdate, points: Int16Array): boolean {
    if (this.tileCount() >= kMaxTiles && this.previous) {
      this.drop(this.previous);
      this.previous = null;
    }
    if (this.tileCount() >= kMaxTiles) return false;
    const { tx, ty, changed_utime_ms } = update;
    const state = { isConfirmed: true, isDirty: true, slot: -1 };
    set.tiles.set(keyOf(tx, ty), { tx, ty, points, changed_utime_ms, ...state });
    return true;
  }

  private remove(set: TileSet, tile: Tile): void {
    if (tile.slot >= 0) this.onFree(tile.slot);
    set.tiles.delete(keyOf(tile.tx, tile.ty));
    markDirty(set, tile.tx, tile.ty);
  }

  private drop(generation: Generation): void {
    for (const set of generation.sets) {
      for (const tile of set.tiles.values()) if (tile.slot >= 0) this.onFree(tile.slot);
      set.tiles.clear();
    }
  }

  forEachTile(visit: (tile: Tile) => void): void {
    for (const { sets } of this.generations()) {
      for (const { tiles } of sets) tiles.forEach(visit);
    }
  }
}

function isInBox(tile: Tile, box: Box, margin: number): boolean {
  return (
    tile.tx + 1 + margin > box.x0_m &&
    tile.tx - margin < box.x1_m &&
    tile.ty + 1 + margin > box.y0_m &&
    tile.ty - margin < box.y1_m
  );
}

// A tile reaches two control points into its neighbours.
function markDirty(set: TileSet, tx: number, ty: number): void {
  for (let dy = -1; dy <= 1; ++dy) {
    for (let dx = -1; dx <= 1; ++dx) {
      const tile = set.find(tx + dx, ty + dy);
      if (tile) tile.isDirty = true;
    }
  }
}

// The control points of a tile with two more on each side, those of its neighbours; row-major.
export const kApron = 2;
export const kApronSide = kTileSide + 2 * kApron;

export function fillWithApron(set: TileSet, tile: Tile, to: Int16Array): void {
  to.fill(0);
  for (let dy = -1; dy <= 1; ++dy) {
    for (let dx = -1; dx <= 1; ++dx) {
      const from = set.find(tile.tx + dx, tile.ty + dy);
      if (from) copyOverlap(from.points, dx * kTileSide, dy * kTileSide, to);
    }
  }
}

// `points` start at (x0, y0) from those of the tile in the middle.
function copyOverlap(points: Int16Array, x0: number, y0: number, to: Int16Array): void {
  const begin_x = Math.max(-kApron - x0, 0);
  const end_x = Math.min(kTileSide + kApron - x0, kTileSide);
  const begin_y = Math.max(-kApron - y0, 0);
  const end_y = Math.min(kTileSide + kApron - y0, kTileSide);
  for (let y = begin_y; y < end_y; ++y) {
    const row = points.subarray(y * kTileSide + begin_x, y * kTileSide + end_x);
    to.set(row, (y + y0 + kApron) * kApronSide + begin_x + x0 + kApron);
  }
}
