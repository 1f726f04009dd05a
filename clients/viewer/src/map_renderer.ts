import { Atlas } from "./atlas";
import { Camera } from "./camera";
import { MapColours, Rgb, kRampSize } from "./colours";
import { kTileSide } from "./frame";
import * as shaders from "./shaders";
import { kStyle } from "./shaders";
import { Generation, Tile, TileSet, TileStore } from "./tile_store";

export type ViewName = "probability" | "log_odds" | "contour" | "gradient" | "last_seen";

// What to draw besides the tiles.
export interface Scene {
  view: ViewName;
  colours: MapColours;
  knot_interval_m: number;
  colourOf(surface: string): Rgb; // of layers
  now_utime_ms: number; // of the clocks that say when a tile changed
}

const kInts = 6; // of an instance: tile x and y, texel x and y, depth, vividness

// The slope that a wall has, in log-odds per knot.
const kSteep = 5;

interface Program {
  program: WebGLProgram;
  at: (name: string) => WebGLUniformLocation | null;
}

// The part of the picture in knots of a level; see shaders.ts.
interface Placement {
  anchor_tx: number;
  anchor_ty: number;
  corner_x: number;
  corner_y: number;
  knots_per_pixel: number;
}

// Draws the tiles of a store with WebGL2. After a lost context everything is made anew.
export class MapRenderer {
  drawTime_ms = 0;
  private readonly gl: WebGL2RenderingContext;
  private resources!: Resources;

  // Throws an Error where there is no WebGL2.
  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly store: TileStore,
    onRestored: () => void,
  ) {
    const options: WebGLContextAttributes = {
      alpha: false,
      antialias: false,
      depth: true,
      stencil: false,
    };
    const gl = canvas.getContext("webgl2", options) as WebGL2RenderingContext | null;
    if (!gl) throw new Error("This browser has no WebGL2, which the map is drawn with.");
    this.gl = gl;
    this.resources = new Resources(gl, store);
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.resources = new Resources(gl, store);
      onRestored();
    });
  }

  draw(camera: Camera, scene: Scene): void {
    if (this.gl.isContextLost()) return;
    const begin_ms = performance.now();
    this.resize(camera);
    this.drawUnknown(camera, scene);
    for (const generation of this.store.generations()) {
      this.drawGeneration(generation, camera, scene);
    }
    this.drawTime_ms = performance.now() - begin_ms;
  }

  // The picture that was just drawn, RGBA, rows from the top.
  readPixels(): Uint8Array {
    const { gl } = this;
    const [width, height] = [this.canvas.width, this.canvas.height];
    const rows = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, rows);
    const picture = new Uint8Array(rows.length);
    for (let y = 0; y < height; ++y) {
      const row = rows.subarray(4 * width * y, 4 * width * (y + 1));
      picture.set(row, 4 * width * (height - 1 - y));
    }
    return picture;
  }

  private resize(camera: Camera): void {
    const width = Math.max(Math.round(camera.width_px * devicePixelRatio), 1);
    const height = Math.max(Math.round(camera.height_px * devicePixelRatio), 1);
    if (this.canvas.width !== width) this.canvas.width = width;
    if (this.canvas.height !== height) this.canvas.height = height;
    this.gl.viewport(0, 0, width, height);
  }

  private drawUnknown(camera: Camera, { view, colours }: Scene): void {
    const { gl } = this;
    const { unknown } = this.resources;
    const box = camera.box();
    const period = 2 * shaders.kHatch_px * devicePixelRatio;
    const offset_px = (box.x0_m + box.y0_m) / camera.view.metres_per_pixel;
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.useProgram(unknown.program);
    setColour(gl, unknown, "unknown", colours.unknown);
    setColour(gl, unknown, "hatch", view === "probability" ? colours.unknown : colours.hatch);
    gl.uniform1f(unknown.at("period"), period);
    gl.uniform1f(unknown.at("offset"), (offset_px * devicePixelRatio) % period);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  private drawGeneration(generation: Generation, camera: Camera, scene: Scene): void {
    const { gl } = this;
    const style = styleOf(generation, scene.view);
    this.useTileProgram(style, scene);
    const isNewestOnTop = style === kStyle.newest;
    const depths = isNewestOnTop ? depthsByAge(generation) : null;
    gl.clear(gl.DEPTH_BUFFER_BIT);
    setEnabled(gl, gl.DEPTH_TEST, isNewestOnTop);
    setEnabled(gl, gl.BLEND, style === kStyle.lines || style === kStyle.tint);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const placement = this.placementOf(generation.level, camera, scene);
    generation.sets.forEach((set, k) => {
      const colour = scene.colourOf(generation.surfaces[k]!);
      this.drawSet(set, colour, placement, depths, scene);
    });
  }

  private useTileProgram(style: number, { view, colours }: Scene): void {
    const { gl } = this;
    const { tiles, ramp } = this.resources;
    gl.useProgram(tiles.program);
    gl.uniform1i(tiles.at("style"), style);
    gl.uniform1f(tiles.at("density"), devicePixelRatio);
    gl.uniform1f(tiles.at("steep"), kSteep);
    gl.uniform1i(tiles.at("atlas"), 0);
    gl.uniform1i(tiles.at("ramp"), 1);
    setColour(gl, tiles, "paper", colours.paper);
    setColour(gl, tiles, "line", colours.ink);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, ramp);
    const size = kRampSize;
    const bytes = rampOf(view, colours);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, size, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    gl.activeTexture(gl.TEXTURE0);
  }

  // Doubles until the corner is relative to a tile nearby.
  private placementOf(level: number, camera: Camera, scene: Scene): Placement {
    const box = camera.box();
    const x = toLevelKnots(box.x0_m / scene.knot_interval_m, level);
    const y = toLevelKnots(box.y0_m / scene.knot_interval_m, level);
    const anchor_tx = Math.floor(x / kTileSide);
    const anchor_ty = Math.floor(y / kTileSide);
    return {
      anchor_tx,
      anchor_ty,
      corner_x: x - anchor_tx * kTileSide,
      corner_y: y - anchor_ty * kTileSide,
      knots_per_pixel:
        camera.view.metres_per_pixel / devicePixelRatio / scene.knot_interval_m / 2 ** level,
    };
  }

  private drawSet(
    set: TileSet,
    colour: Rgb,
    placement: Placement,
    depths: Map<Tile, number> | null,
    scene: Scene,
  ): void {
    const { gl } = this;
    const { tiles, atlas } = this.resources;
    const size_x = this.canvas.width * placement.knots_per_pixel;
    const size_y = this.canvas.height * placement.knots_per_pixel;
    gl.uniform2f(tiles.at("corner"), placement.corner_x, placement.corner_y);
    gl.uniform2f(tiles.at("picture_size"), size_x, size_y);
    gl.uniform1f(tiles.at("knots_per_pixel"), placement.knots_per_pixel);
    setColour(gl, tiles, "colour", colour);
    const pages: Tile[][] = [];
    for (const tile of set.tiles.values()) {
      if (!isOnPicture(tile, placement, size_x, size_y) || !atlas.upload(set, tile)) continue;
      (pages[atlas.pageOf(tile)] ??= []).push(tile);
    }
    pages.forEach((shown, page) => {
      gl.bindTexture(gl.TEXTURE_2D, atlas.pages[page]!);
      this.drawInstances(shown, placement, depths, scene);
    });
  }

  private drawInstances(
    shown: Tile[],
    placement: Placement,
    depths: Map<Tile, number> | null,
    scene: Scene,
  ): void {
    const { gl } = this;
    const ints = new Int32Array(kInts * shown.length);
    const floats = new Float32Array(ints.buffer);
    shown.forEach((tile, k) => {
      const [x, y] = this.resources.atlas.texelOf(tile);
      ints.set([tile.tx - placement.anchor_tx, tile.ty - placement.anchor_ty, x, y], kInts * k);
      floats[kInts * k + 4] = depths?.get(tile) ?? 0;
      floats[kInts * k + 5] = vividness(scene.now_utime_ms - tile.changed_utime_ms);
    });
    gl.bindVertexArray(this.resources.instances);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.resources.instanceBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, ints, gl.STREAM_DRAW);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, shown.length);
    gl.bindVertexArray(null);
  }
}

// What is lost with the context.
class Resources {
  readonly tiles: Program;
  readonly unknown: Program;
  readonly atlas: Atlas;
  readonly ramp: WebGLTexture;
  readonly instances: WebGLVertexArrayObject;
  readonly instanceBuffer: WebGLBuffer;

  constructor(gl: WebGL2RenderingContext, store: TileStore) {
    this.tiles = link(gl, shaders.kTileVertexShader, shaders.kTileFragmentShader);
    this.unknown = link(gl, shaders.kUnknownVertexShader, shaders.kUnknownFragmentShader);
    this.atlas = new Atlas(gl, store);
    this.ramp = makeRamp(gl);
    this.instanceBuffer = gl.createBuffer()!;
    this.instances = makeInstances(gl, this.instanceBuffer);
    gl.disable(gl.DITHER);
  }
}

function makeRamp(gl: WebGL2RenderingContext): WebGLTexture {
  const ramp = gl.createTexture()!;
  gl.bindTexture(gl.TEXTURE_2D, ramp);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  return ramp;
}

function makeInstances(gl: WebGL2RenderingContext, buffer: WebGLBuffer): WebGLVertexArrayObject {
  const instances = gl.createVertexArray()!;
  gl.bindVertexArray(instances);
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.vertexAttribIPointer(0, 2, gl.INT, 4 * kInts, 0);
  gl.vertexAttribIPointer(1, 2, gl.INT, 4 * kInts, 8);
  gl.vertexAttribPointer(2, 1, gl.FLOAT, false, 4 * kInts, 16);
  gl.vertexAttribPointer(3, 1, gl.FLOAT, false, 4 * kInts, 20);
  for (let k = 0; k < 4; ++k) {
    gl.enableVertexAttribArray(k);
    gl.vertexAttribDivisor(k, 1);
  }
  gl.bindVertexArray(null);
  return instances;
}

function link(gl: WebGL2RenderingContext, vertex: string, fragment: string): Program {
  const program = gl.createProgram()!;
  gl.attachShader(program, compile(gl, gl.VERTEX_SHADER, vertex));
  gl.attachShader(program, compile(gl, gl.FRAGMENT_SHADER, fragment));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(`A shader cannot be linked: ${gl.getProgramInfoLog(program)}`);
  }
  const places = new Map<string, WebGLUniformLocation | null>();
  const at = (name: string) => {
    if (!places.has(name)) places.set(name, gl.getUniformLocation(program, name));
    return places.get(name)!;
  };
  return { program, at };
}

function compile(gl: WebGL2RenderingContext, type: number, source: string): WebGLShader {
  const shader = gl.createShader(type)!;
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
    throw new Error(`A shader cannot be compiled: ${gl.getShaderInfoLog(shader)}`);
  }
  return shader;
}

function setColour(gl: WebGL2RenderingContext, to: Program, name: string, [r, g, b]: Rgb): void {
  gl.uniform3f(to.at(name), r / 255, g / 255, b / 255);
}

function setEnabled(gl: WebGL2RenderingContext, what: number, isEnabled: boolean): void {
  if (isEnabled) gl.enable(what);
  else gl.disable(what);
}

// A control point of level n is in the middle of the 2^n finer ones that it stands for.
export function toLevelKnots(knots: number, level: number): number {
  return (knots - (2 ** level - 1) / 2) / 2 ** level;
}

function isOnPicture(tile: Tile, placement: Placement, size_x: number, size_y: number): boolean {
  const x = (tile.tx - placement.anchor_tx) * kTileSide - 0.5 - placement.corner_x;
  const y = (tile.ty - placement.anchor_ty) * kTileSide - 0.5 - placement.corner_y;
  return x + kTileSide > 0 && x < size_x && y + kTileSide > 0 && y < size_y;
}

// Layers are drawn in their colours; the sum in the style of the view.
function styleOf(generation: Generation, view: ViewName): number {
  const isSum = generation.surfaces[0] === "sum";
  if (!isSum && view === "last_seen") return kStyle.newest;
  if (!isSum) return view === "contour" ? kStyle.lines : kStyle.tint;
  switch (view) {
    case "log_odds":
      return kStyle.logOdds;
    case "contour":
      return kStyle.contour;
    case "gradient":
      return kStyle.gradient;
    default:
      return kStyle.probability;
  }
}

function rampOf(view: ViewName, colours: MapColours): Uint8Array {
  switch (view) {
    case "log_odds":
      return colours.logOdds;
    case "contour":
      return colours.contour;
    case "gradient":
      return colours.direction;
    default:
      return colours.probability;
  }
}

// From 1, the oldest, to -1: the tile that changed last is in front.
function depthsByAge(generation: Generation): Map<Tile, number> {
  const tiles = generation.sets.flatMap((set) => [...set.tiles.values()]);
  tiles.sort((a, b) => a.changed_utime_ms - b.changed_utime_ms);
  return new Map(tiles.map((tile, k) => [tile, 1 - (2 * (k + 1)) / (tiles.length + 1)]));
}

// 1 within the last seconds, 0 after an hour; equal steps for equal factors.
export function vividness(age_ms: number): number {
  const age_s = Math.max(age_ms / 1000, 0);
  return Math.max(1 - Math.log(1 + age_s / 5) / Math.log(1 + 3600 / 5), 0);
}
