import { Camera } from "./camera";
import { ViewRequest } from "./connection";
import { Box, kTileSide } from "./frame";
import { toLevelKnots } from "./map_renderer";

const kMaxLevel = 8;
const kMargin = 0.2; // of the width and height, asked for around the screen
const kMaxTilesOfSurface = 4000; // the server sends 4,096
const kMaxTilesAsked = 6000; // of all surfaces, so that the generation before fits in as well

export interface Surface {
  name: string;
  tiles: number; // at level 0, which is more than at any other
  bounds: Box | null; // null: not told
}

// The finest level with a pixel of the screen per knot or more, and not too many tiles.
function chooseLevel(camera: Camera, knot_interval_m: number, surfaces: Surface[]): number {
  const pixel_m = camera.view.metres_per_pixel / devicePixelRatio;
  const box = withMargin(camera.box());
  for (let level = 0; level < kMaxLevel; ++level) {
    if (knot_interval_m * 2 ** level < pixel_m) continue;
    const tiles = tilesIn(box, knot_interval_m, level);
    const asked = surfaces.reduce((sum, surface) => {
      const part = surface.bounds ? intersection(box, surface.bounds) : box;
      return sum + Math.min(tilesIn(part, knot_interval_m, level), surface.tiles);
    }, 0);
    if (tiles <= kMaxTilesOfSurface && asked <= kMaxTilesAsked) return level;
  }
  return kMaxLevel;
}

export function requestFor(
  camera: Camera,
  knot_interval_m: number,
  surfaces: Surface[],
): ViewRequest {
  const level = chooseLevel(camera, knot_interval_m, surfaces);
  return { ...withMargin(camera.box()), level, surfaces: surfaces.map(({ name }) => name) };
}

// Whether tiles of the request fill the screen, at the level that fits.
export function serves(request: ViewRequest, wanted: ViewRequest, camera: Camera): boolean {
  const box = camera.box();
  return (
    request.level === wanted.level &&
    request.surfaces.join("\n") === wanted.surfaces.join("\n") &&
    request.x0_m <= box.x0_m &&
    request.y0_m <= box.y0_m &&
    request.x1_m >= box.x1_m &&
    request.y1_m >= box.y1_m &&
    // One that was made for far more than the screen keeps the server busy for nothing.
    request.x1_m - request.x0_m <= 2 * (wanted.x1_m - wanted.x0_m)
  );
}

// The box in tiles of the level.
export function boxInTiles(box: Box, knot_interval_m: number, level: number): Box {
  const toTiles = (at_m: number) => toLevelKnots(at_m / knot_interval_m, level) / kTileSide;
  return {
    x0_m: toTiles(box.x0_m),
    y0_m: toTiles(box.y0_m),
    x1_m: toTiles(box.x1_m),
    y1_m: toTiles(box.y1_m),
  };
}

function withMargin({ x0_m, y0_m, x1_m, y1_m }: Box): Box {
  const margin_x_m = kMargin * (x1_m - x0_m);
  const margin_y_m = kMargin * (y1_m - y0_m);
  return {
    x0_m: x0_m - margin_x_m,
    y0_m: y0_m - margin_y_m,
    x1_m: x1_m + margin_x_m,
    y1_m: y1_m + margin_y_m,
  };
}

export function tileSide_m(knot_interval_m: number, level: number): number {
  return knot_interval_m * 2 ** level * kTileSide;
}

function tilesIn(box: Box, knot_interval_m: number, level: number): number {
  const side_m = tileSide_m(knot_interval_m, level);
  const across = (side: number) => Math.max(side / side_m, 0) + 1;
  return across(box.x1_m - box.x0_m) * across(box.y1_m - box.y0_m);
}

function intersection(a: Box, b: Box): Box {
  return {
    x0_m: Math.max(a.x0_m, b.x0_m),
    y0_m: Math.max(a.y0_m, b.y0_m),
    x1_m: Math.min(a.x1_m, b.x1_m),
    y1_m: Math.min(a.y1_m, b.y1_m),
  };
}
