import { Camera, Pixel } from "./camera";

interface Handlers {
  onMoved(): void; // the user moved the map
  onClick(at: Pixel): void;
  onHover(at: Pixel | null): void;
  takesDrags(): boolean; // the tool, in place of moving the map
  onDrag(from: Pixel, to: Pixel): void;
  onDragEnd(from: Pixel, to: Pixel): void;
}

const kClick_px = 5; // a pointer that moved less clicked
const kWheelLine_px = 32;
const kZoomPerPixel = 0.0022;

// Pointers and the wheel on the map: one pointer moves it, two zoom it as well.
export class Gestures {
  private readonly pointers = new Map<number, Pixel>();
  private pressed: Pixel | null = null; // where a click may be under way
  private isDrag = false;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly camera: Camera,
    private readonly handlers: Handlers,
  ) {
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.release(event));
    canvas.addEventListener("pointercancel", (event) => this.cancel(event));
    canvas.addEventListener("pointerleave", () => this.handlers.onHover(null));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
  }

  private at(event: MouseEvent): Pixel {
    const { left, top } = this.canvas.getBoundingClientRect();
    return { x_px: event.clientX - left, y_px: event.clientY - top };
  }

  private press(event: PointerEvent): void {
    if (event.button !== 0) return;
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, this.at(event));
    const isFirst = this.pointers.size === 1;
    this.pressed = isFirst ? this.at(event) : null;
    this.isDrag = false;
  }

  private move(event: PointerEvent): void {
    const to = this.at(event);
    const from = this.pointers.get(event.pointerId);
    if (event.pointerType !== "touch") this.handlers.onHover(to);
    if (!from) return;
    if (this.pressed && distance(this.pressed, to) >= kClick_px) this.isDrag = true;
    if (this.pressed && this.handlers.takesDrags()) {
      if (this.isDrag) this.handlers.onDrag(this.pressed, to);
      return;
    }
    if (this.pressed && !this.isDrag) return;
    this.moveMap(event.pointerId, from, to);
  }

  private moveMap(id: number, from: Pixel, to: Pixel): void {
    const other = [...this.pointers].find(([otherId]) => otherId !== id)?.[1];
    this.pointers.set(id, to);
    if (other) {
      // The middle moves by half, and the distance changes around it.
      this.camera.panBy((to.x_px - from.x_px) / 2, (to.y_px - from.y_px) / 2);
      const middle = { x_px: (to.x_px + other.x_px) / 2, y_px: (to.y_px + other.y_px) / 2 };
      this.camera.zoomAt(middle, distance(to, other) / Math.max(distance(from, other), 1));
    } else {
      this.canvas.classList.add("is-moving");
      this.camera.panBy(to.x_px - from.x_px, to.y_px - from.y_px);
    }
    this.handlers.onMoved();
  }

  private release(event: PointerEvent): void {
    const { pressed } = this;
    const to = this.at(event);
    const isPressed = this.pointers.has(event.pointerId);
    this.cancel(event);
    if (!pressed || !isPressed) return;
    if (!this.isDrag) this.handlers.onClick(to);
    else if (this.handlers.takesDrags()) this.handlers.onDragEnd(pressed, to);
  }

  private cancel(event: PointerEvent): void {
    this.pointers.delete(event.pointerId);
    this.pressed = null;
    this.canvas.classList.remove("is-moving");
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    const unit_px = event.deltaMode === WheelEvent.DOM_DELTA_PIXEL ? 1 : kWheelLine_px;
    const turned_px = Math.max(-300, Math.min(300, event.deltaY * unit_px));
    const factor = Math.exp(-turned_px * kZoomPerPixel * (event.ctrlKey ? 4 : 1));
    this.camera.zoomAt(this.at(event), factor);
    this.handlers.onMoved();
  }
}

function distance(a: Pixel, b: Pixel): number {
  return Math.hypot(a.x_px - b.x_px, a.y_px - b.y_px);
}
