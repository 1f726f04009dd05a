import { Camera, Pixel, Point } from "./camera";
import { Rgb, Theme, categoryColour, css } from "./colours";
import { Pose, Scan } from "./frame";
import { LiveState } from "./live_state";
import { Tools, lengthOf } from "./tools";
import { kDaemonSilent_s, metres } from "./words";

const kMaxTrailStep_m = 3; // a replay that jumps, or poses that were not seen

export type Shown = Record<"robots" | "trails" | "scans" | "paths", boolean>;

interface Inks {
  halo: string;
  text: string;
  scan: string;
  path: string;
  free: string;
  blocked: string;
  unknown: string;
  mark: string;
}

const kInks: Record<Theme, Inks> = {
  light: {
    halo: "rgba(255, 255, 255, 0.9)",
    text: "#1a222c",
    scan: "#d4145a",
    path: "#6b3fe0",
    free: "#0a7f5a",
    blocked: "#c62828",
    unknown: "#9a6400",
    mark: "#0b63c5",
  },
  dark: {
    halo: "rgba(12, 16, 22, 0.85)",
    text: "#f0f3f7",
    scan: "#ff5c93",
    path: "#b49bff",
    free: "#3ddba4",
    blocked: "#ff7a6e",
    unknown: "#f2b84b",
    mark: "#6cb4ff",
  },
};

const kRobot_px = 11;
const kHatch_px = 8;

// What lies over the map: robots and what they see, and the marks of the tools.
export class Overlay {
  private readonly context: CanvasRenderingContext2D;
  private theme: Theme = "light";
  private inks = kInks.light;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly camera: Camera,
  ) {
    this.context = canvas.getContext("2d")!;
  }

  draw(live: LiveState, tools: Tools, shown: Shown, theme: Theme): void {
    this.begin(theme);
    if (shown.trails) this.drawTrails(live);
    if (shown.paths) this.drawPaths(live);
    if (shown.scans) for (const scan of live.scans) this.drawScan(scan);
    this.drawSegment(tools);
    this.drawMeasure(tools);
    if (tools.inspected) this.drawCross(tools.inspected, this.inks.mark);
    if (tools.goal) this.drawGoal(tools.goal);
    if (shown.robots) for (const pose of live.poses) this.drawRobot(pose, live);
  }

  private begin(theme: Theme): void {
    this.theme = theme;
    this.inks = kInks[theme];
    const { width_px, height_px } = this.camera;
    const width = Math.round(width_px * devicePixelRatio);
    const height = Math.round(height_px * devicePixelRatio);
    if (this.canvas.width !== width) this.canvas.width = width;
    if (this.canvas.height !== height) this.canvas.height = height;
    const { context } = this;
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    context.clearRect(0, 0, width_px, height_px);
    context.globalAlpha = 1;
    // Chromium goes on showing an older picture where nothing but clearRect was drawn.
    context.fillStyle = "rgba(128, 128, 128, 0.01)";
    context.fillRect(0, 0, 1, 1);
    context.lineJoin = context.lineCap = "round";
    context.font = "600 12px system-ui, sans-serif";
  }

  private pixelOf({ x_m, y_m }: Point): Pixel {
    return this.camera.toPixel(x_m, y_m);
  }

  // Steps longer than `max_step_m` are gaps.
  private trace(points_m: number[], max_step_m = Infinity): void {
    const { context } = this;
    context.beginPath();
    for (let k = 0; k + 1 < points_m.length; k += 2) {
      const { x_px, y_px } = this.camera.toPixel(points_m[k]!, points_m[k + 1]!);
      const step_m =
        k === 0 ? Infinity : Math.hypot(points_m[k]! - points_m[k - 2]!, points_m[k + 1]! - points_m[k - 1]!);
      if (k === 0 || step_m > max_step_m) context.moveTo(x_px, y_px);
      else context.lineTo(x_px, y_px);
    }
  }

  private stroke(colour: string, width_px: number): void {
    this.context.strokeStyle = colour;
    this.context.lineWidth = width_px;
    this.context.stroke();
  }

  // With a halo, so that it is seen on light and dark ground.
  private strokeWithHalo(colour: string, width_px: number): void {
    this.stroke(this.inks.halo, width_px + 2.5);
    this.stroke(colour, width_px);
  }

  private drawTrails(live: LiveState): void {
    for (const { channel, points_m } of live.trails.values()) {
      this.trace(points_m, kMaxTrailStep_m);
      this.stroke(css(this.channelColour(live, channel), 0.55), 1.75);
    }
  }

  private drawPaths(live: LiveState): void {
    for (const { points_m, heard_s_ago } of live.paths) {
      this.context.globalAlpha = opacity(heard_s_ago);
      this.trace(points_m);
      this.strokeWithHalo(this.inks.path, 2.5);
      this.context.globalAlpha = 1;
    }
  }

  private drawScan({ points_m, heard_s_ago }: Scan): void {
    const { context, camera } = this;
    context.globalAlpha = 0.9 * opacity(heard_s_ago);
    context.fillStyle = this.inks.scan;
    for (let k = 0; k + 1 < points_m.length; k += 2) {
      const { x_px, y_px } = camera.toPixel(points_m[k]!, points_m[k + 1]!);
      context.fillRect(x_px - 1.25, y_px - 1.25, 2.5, 2.5);
    }
    context.globalAlpha = 1;
  }

  private drawRobot(pose: Pose, live: LiveState): void {
    const colour = css(this.channelColour(live, pose.channel));
    const at = this.pixelOf(pose);
    if (!this.isOnScreen(at)) return;
    this.context.globalAlpha = opacity(pose.heard_s_ago);
    this.drawArrow(at, pose.yaw_rad, kRobot_px, colour);
    this.drawLabel(pose.channel.slice(0, 40), { x_px: at.x_px + 14, y_px: at.y_px - 12 });
    this.context.globalAlpha = 1;
  }

  private isOnScreen({ x_px, y_px }: Pixel): boolean {
    const { width_px, height_px } = this.camera;
    const margin_px = 2 * kRobot_px;
    return (
      x_px > -margin_px &&
      y_px > -margin_px &&
      x_px < width_px + margin_px &&
      y_px < height_px + margin_px
    );
  }

  private channelColour(live: LiveState, channel: string): Rgb {
    return categoryColour(live.colourIndex("channel", channel), this.theme);
  }

  private drawArrow({ x_px, y_px }: Pixel, yaw_rad: number, size_px: number, colour: string): void {
    const { context } = this;
    context.save();
    context.translate(x_px, y_px);
    context.rotate(-yaw_rad);
    context.beginPath();
    context.moveTo(size_px, 0);
    context.lineTo(-0.8 * size_px, 0.7 * size_px);
    context.lineTo(-0.4 * size_px, 0);
    context.lineTo(-0.8 * size_px, -0.7 * size_px);
    context.closePath();
    context.fillStyle = colour;
    this.stroke(this.inks.halo, 4);
    context.fill();
    context.restore();
  }

  private drawLabel(text: string, at: Pixel): void {
    const { context } = this;
    const { y_px } = at;
    const x_px = Math.min(at.x_px, this.camera.width_px - context.measureText(text).width - 6);
    context.textBaseline = "middle";
    context.textAlign = "left";
    context.strokeStyle = this.inks.halo;
    context.lineWidth = 3.5;
    context.strokeText(text, x_px, y_px);
    context.fillStyle = this.inks.text;
    context.fillText(text, x_px, y_px);
  }

  private drawCross(point: Point, colour: string): void {
    const { x_px, y_px } = this.pixelOf(point);
    const { context } = this;
    context.beginPath();
    for (const [dx, dy] of [
      [1, 0],
      [-1, 0],
      [0, 1],
      [0, -1],
    ] as const) {
      context.moveTo(x_px + 5 * dx, y_px + 5 * dy);
      context.lineTo(x_px + 12 * dx, y_px + 12 * dy);
    }
    this.strokeWithHalo(colour, 2);
    context.beginPath();
    context.arc(x_px, y_px, 2, 0, 2 * Math.PI);
    this.strokeWithHalo(colour, 1.5);
  }

  private drawGoal(goal: Point & { yaw_rad: number }): void {
    const at = this.pixelOf(goal);
    this.context.beginPath();
    this.context.arc(at.x_px, at.y_px, 17, 0, 2 * Math.PI);
    this.strokeWithHalo(this.inks.free, 2);
    this.drawArrow(at, goal.yaw_rad, kRobot_px, this.inks.free);
  }

  private drawMeasure({ measured, hover, active }: Tools): void {
    const points = withPending(measured, active === "measure" ? hover : null);
    if (points.length === 0) return;
    const ends = points.map((point) => this.pixelOf(point));
    this.traceEnds(ends);
    this.strokeWithHalo(this.inks.mark, 2);
    for (const end of ends) this.drawDot(end, this.inks.mark);
    if (points.length === 2) this.drawLabelAtMiddle(metres(lengthOf(points)), ends);
  }

  private traceEnds(ends: Pixel[]): void {
    this.context.beginPath();
    ends.forEach(({ x_px, y_px }, k) => {
      if (k === 0) this.context.moveTo(x_px, y_px);
      else this.context.lineTo(x_px, y_px);
    });
  }

  private drawDot({ x_px, y_px }: Pixel, colour: string): void {
    const { context } = this;
    context.beginPath();
    context.arc(x_px, y_px, 3.5, 0, 2 * Math.PI);
    this.stroke(this.inks.halo, 3);
    context.fillStyle = colour;
    context.fill();
  }

  private drawLabelAtMiddle(text: string, [a, b]: Pixel[]): void {
    const middle = { x_px: (a!.x_px + b!.x_px) / 2 + 10, y_px: (a!.y_px + b!.y_px) / 2 - 12 };
    this.drawLabel(text, middle);
  }

  // What the disc sweeps: free up to where it touches something, hatched beyond.
  private drawSegment(tools: Tools): void {
    const points = withPending(tools.segment, tools.active === "segment" ? tools.hover : null);
    if (points.length === 0) return;
    const ends = points.map((point) => this.pixelOf(point));
    const radius_px = Math.max(tools.radius_m / this.camera.view.metres_per_pixel, 1.5);
    if (tools.check && ends.length === 2) this.drawCheck(tools, ends as [Pixel, Pixel], radius_px);
    else this.drawCapsule(ends, radius_px, this.inks.mark, false);
    this.traceEnds(ends);
    this.stroke(this.inks.mark, 1.5);
    for (const end of ends) this.drawDot(end, this.inks.mark);
  }

  private drawCheck(tools: Tools, [from, to]: [Pixel, Pixel], radius_px: number): void {
    const { check, segment } = tools;
    if (!check) return;
    if (check.occupancy === "free") {
      this.drawCapsule([from, to], radius_px, this.inks.free, !check.is_certified);
      return;
    }
    const part = Math.min(check.free_m / Math.max(lengthOf(segment), 1e-9), 1);
    const stop = {
      x_px: from.x_px + part * (to.x_px - from.x_px),
      y_px: from.y_px + part * (to.y_px - from.y_px),
    };
    const bad = check.occupancy === "occupied" ? this.inks.blocked : this.inks.unknown;
    this.drawCapsule([stop, to], radius_px, bad, true);
    this.drawCapsule([from, stop], radius_px, this.inks.free, false);
    if (check.contact) this.drawCross(check.contact, bad);
  }

  private drawCapsule(ends: Pixel[], radius_px: number, colour: string, isHatched: boolean): void {
    const { context } = this;
    const [from, to = from] = ends as [Pixel, Pixel | undefined];
    const angle = Math.atan2(to!.y_px - from.y_px, to!.x_px - from.x_px);
    context.beginPath();
    context.arc(from.x_px, from.y_px, radius_px, angle + Math.PI / 2, angle - Math.PI / 2);
    context.arc(to!.x_px, to!.y_px, radius_px, angle - Math.PI / 2, angle + Math.PI / 2);
    context.closePath();
    context.save();
    context.globalAlpha = isHatched ? 0.18 : 0.28;
    context.fillStyle = colour;
    context.fill();
    context.globalAlpha = 1;
    this.strokeWithHalo(colour, 1.75);
    if (isHatched) this.hatch(colour);
    context.restore();
  }

  // Inside the current path.
  private hatch(colour: string): void {
    const { context, camera } = this;
    context.clip();
    context.beginPath();
    for (let x = -camera.height_px; x < camera.width_px; x += kHatch_px) {
      context.moveTo(x, camera.height_px);
      context.lineTo(x + camera.height_px, 0);
    }
    this.stroke(colour, 1.25);
  }
}

function withPending(points: Point[], hover: Point | null): Point[] {
  return points.length === 1 && hover ? [...points, hover] : points;
}

function opacity(heard_s_ago: number): number {
  return heard_s_ago > kDaemonSilent_s ? 0.4 : 1;
}
