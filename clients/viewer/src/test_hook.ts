import { Pixel, Point, View } from "./camera";
import { Theme } from "./colours";
import { ViewName } from "./map_renderer";

// window.splinemapViewer: what tests see of the page and can do with it. Pixels are those of CSS,
// from the upper left corner of the map's canvas; a pixel's middle is at half.
export interface TestHook {
  readonly isConnected: boolean;
  readonly isComplete: boolean; // all tiles of the view are here, and drawn with the next frame
  readonly frameCount: number; // how often the map was drawn
  readonly drawTime_ms: number; // of the newest, without what the GPU does later
  readonly tileCount: number; // of all levels and surfaces kept
  readonly level: number;
  readonly surfaces: readonly string[];
  readonly revision: number; // of the map
  readonly shownUtime: number | null; // of the map; null: now
  readonly lastError: string; // "": none yet
  readonly view: View;
  worldToPixel(x_m: number, y_m: number): Pixel;
  pixelToWorld(x_px: number, y_px: number): Point;
  setView(view: View): void; // as if the user had moved there
  setViewName(name: ViewName): void;
  setTheme(theme: Theme): void;
  // Draws, and gives the map without what lies over it: RGBA, rows from the top, device pixels.
  readPixels(): { width: number; height: number; data: Uint8Array };
}

declare global {
  interface Window {
    splinemapViewer: TestHook;
  }
}
