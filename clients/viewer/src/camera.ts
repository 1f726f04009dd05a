import { Box } from "./frame";

export interface View {
  centre_x_m: number;
  centre_y_m: number;
  metres_per_pixel: number; // CSS pixels
}

export interface Point {
  x_m: number;
  y_m: number;
}

export interface Pixel {
  x_px: number;
  y_px: number;
}

export interface Insets {
  left_px: number;
  top_px: number;
  right_px: number;
  bottom_px: number;
}

const kMinMetresPerPixel = 1e-4;
const kMaxMetresPerPixel = 50;
const kFitMargin = 1.12;

// Where the map is on the canvas. Pixels are those of CSS, from the upper left corner, y down; the
// map's y is up. Doubles all through, so that maps far from the origin stay sharp.
export class Camera {
  view: View = { centre_x_m: 0, centre_y_m: 0, metres_per_pixel: 0.02 };
  width_px = 1;
  height_px = 1;

  toPixel(x_m: number, y_m: number): Pixel {
    const { centre_x_m, centre_y_m, metres_per_pixel } = this.view;
    return {
      x_px: this.width_px / 2 + (x_m - centre_x_m) / metres_per_pixel,
      y_px: this.height_px / 2 - (y_m - centre_y_m) / metres_per_pixel,
    };
  }

  toMap(x_px: number, y_px: number): Point {
    const { centre_x_m, centre_y_m, metres_per_pixel } = this.view;
    return {
      x_m: centre_x_m + (x_px - this.width_px / 2) * metres_per_pixel,
      y_m: centre_y_m - (y_px - this.height_px / 2) * metres_per_pixel,
    };
  }

  box(): Box {
    const lower = this.toMap(0, this.height_px);
    const upper = this.toMap(this.width_px, 0);
    return { x0_m: lower.x_m, y0_m: lower.y_m, x1_m: upper.x_m, y1_m: upper.y_m };
  }

  setView(view: View): void {
    const metres_per_pixel = clamp(view.metres_per_pixel, kMinMetresPerPixel, kMaxMetresPerPixel);
    this.view = { ...view, metres_per_pixel };
  }

  panBy(dx_px: number, dy_px: number): void {
    const { centre_x_m, centre_y_m, metres_per_pixel } = this.view;
    this.view = {
      centre_x_m: centre_x_m - dx_px * metres_per_pixel,
      centre_y_m: centre_y_m + dy_px * metres_per_pixel,
      metres_per_pixel,
    };
  }

  // What is under the pixel stays there. A factor above 1 shows more detail.
  zoomAt(pixel: Pixel, factor: number): void {
    const before = this.toMap(pixel.x_px, pixel.y_px);
    this.setView({ ...this.view, metres_per_pixel: this.view.metres_per_pixel / factor });
    const after = this.toMap(pixel.x_px, pixel.y_px);
    this.view.centre_x_m += before.x_m - after.x_m;
    this.view.centre_y_m += before.y_m - after.y_m;
  }

  // The box is shown in the part of the canvas that nothing covers.
  fit(box: Box, insets: Insets): void {
    const width_px = Math.max(this.width_px - insets.left_px - insets.right_px, 50);
    const height_px = Math.max(this.height_px - insets.top_px - insets.bottom_px, 50);
    const scale = Math.max((box.x1_m - box.x0_m) / width_px, (box.y1_m - box.y0_m) / height_px);
    this.setView({
      centre_x_m: (box.x0_m + box.x1_m) / 2,
      centre_y_m: (box.y0_m + box.y1_m) / 2,
      metres_per_pixel: kFitMargin * scale,
    });
    this.panBy((insets.left_px - insets.right_px) / 2, (insets.top_px - insets.bottom_px) / 2);
  }
}

export function clamp(value: number, least: number, greatest: number): number {
  return Math.min(Math.max(value, least), greatest);
}
