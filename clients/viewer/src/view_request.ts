import { Camera } from "./camera";
import { ViewRequest } from "./connection";
import { Box, kTileSide } from "./frame";
import { toLevelKnots } from "./map_renderer";

const kMaxLevel = 8;
const kMargin = 0.2; // of the width and height, asked for around the screen
const kMaxTilesOfSurface = 4000; // the server sends 4,096
const kMaxTilesAsked = 6000; // of all surfaces, so that the generation before fits in as well

// The finest level with a pixel of the screen per knot or more, and not too many tiles.
export function chooseLevel(camera: Camera, knot_interval_m: number, surfaces: number): number {
  const pixel_m = camera.view.metres_per_pixel / devicePixelRatio;
  const limit = Math.min(kMaxTilesOfSurface, kMaxTilesAsked / surfaces);
  const box = withMargin(camera.box());
  for (let level = 0; level < kMaxLevel; ++level) {
    const isFineEnough = knot_interval_m * 2 ** level >= pixel_m;
    if (isFineEnough && tilesIn(box, knot_interval_m, level) <= limit) return level;
  }
  return kMaxLevel;
}

export function requestFor(
  camera: Camera,
  knot_interval_m: number,
  surfaces: string[],
): ViewRequest {
  const level = chooseLevel(camera, knot_interval_m, surfaces.length);
  return { ...withMargin(camera.box()), level, surfaces };
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

function tilesIn(box: Box, knot_interval_m: number, level: number): number {
  const side_m = knot_interval_m * 2 ** level * kTileSide;
  return ((box.x1_m - box.x0_m) / side_m + 1) * ((box.y1_m - box.y0_m) / side_m + 1);
}
