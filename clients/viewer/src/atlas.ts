import {
  Tile,
  TileSet,
  TileStore,
  fillWithApron,
  kApron,
  kApronSide,
  kMaxTiles,
} from "./tile_store";

const kTilesPerSide = 56;
const kPageSide = kTilesPerSide * kApronSide; // 2016 texels, 8 MB
const kTilesPerPage = kTilesPerSide * kTilesPerSide;

// The control points of tiles in textures of 16-bit integers, each tile with an apron of what its
// neighbours have there. Pages are made when they are needed, four at most.
export class Atlas {
  readonly pages: WebGLTexture[] = [];
  private free: number[] = [];
  private readonly buffer = new Int16Array(kApronSide * kApronSide);

  constructor(
    private readonly gl: WebGL2RenderingContext,
    store: TileStore,
  ) {
    store.onFree = (slot) => this.free.push(slot);
    store.forEachTile((tile) => Object.assign(tile, { slot: -1, isDirty: true }));
  }

  // False where there is no room for it.
  upload(set: TileSet, tile: Tile): boolean {
    if (tile.slot < 0) tile.slot = this.takeSlot();
    if (tile.slot < 0) return false;
    if (!tile.isDirty) return true;
    fillWithApron(set, tile, this.buffer);
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.pages[this.pageOf(tile)]!);
    const [x, y] = this.texelOf(tile);
    const [x0, y0] = [x - kApron, y - kApron];
    const side = kApronSide;
    gl.texSubImage2D(gl.TEXTURE_2D, 0, x0, y0, side, side, gl.RED_INTEGER, gl.SHORT, this.buffer);
    tile.isDirty = false;
    return true;
  }

  pageOf(tile: Tile): number {
    return Math.floor(tile.slot / kTilesPerPage);
  }

  // Of control point (0, 0).
  texelOf(tile: Tile): [number, number] {
    const slot = tile.slot % kTilesPerPage;
    const x = (slot % kTilesPerSide) * kApronSide + kApron;
    return [x, Math.floor(slot / kTilesPerSide) * kApronSide + kApron];
  }

  private takeSlot(): number {
    if (this.free.length === 0 && this.pages.length < Math.ceil(kMaxTiles / kTilesPerPage)) {
      this.addPage();
    }
    return this.free.pop() ?? -1;
  }

  private addPage(): void {
    const { gl } = this;
    const page = gl.createTexture()!;
    gl.bindTexture(gl.TEXTURE_2D, page);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.R16I, kPageSide, kPageSide);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    const first = this.pages.length * kTilesPerPage;
    for (let k = kTilesPerPage - 1; k >= 0; --k) this.free.push(first + k);
    this.pages.push(page);
  }
}
