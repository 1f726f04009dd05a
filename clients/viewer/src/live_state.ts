import { Box, Daemon, Frame, Layer, MapInfo, MapTimes, Path, Pose, Scan } from "./frame";

const kMaxTrailPoints = 5000;
const kMaxTrails = 32;
const kTrailStep_m = 0.03;

// Where a robot was, thinned; x, y, x, y, ..
export interface Trail {
  channel: string;
  points_m: number[];
}

// The newest of everything that the server told, tiles apart.
export class LiveState {
  map: MapInfo | null = null;
  times: MapTimes | null = null;
  layers: Layer[] = [];
  daemons: Daemon[] = [];
  poses: Pose[] = [];
  scans: Scan[] = [];
  paths: Path[] = [];
  trails = new Map<string, Trail>();
  private colours = new Map<string, number>();

  take(frame: Frame): void {
    this.map = frame.map ?? this.map;
    this.times = frame.times ?? this.times;
    this.layers = frame.layers ?? this.layers;
    this.daemons = frame.daemons ?? this.daemons;
    this.scans = frame.scans ?? this.scans;
    this.paths = frame.paths ?? this.paths;
    if (frame.poses) this.takePoses(frame.poses);
  }

  // The order in which layers and channels came, for colours that do not change.
  colourIndex(kind: "layer" | "channel", name: string): number {
    const key = `${kind} ${name}`;
    let index = this.colours.get(key);
    if (index === undefined) {
      index = [...this.colours.keys()].filter((other) => other.startsWith(kind)).length;
      this.colours.set(key, index);
    }
    return index;
  }

  layer(key: string): Layer | undefined {
    return this.layers.find((layer) => layer.key === key);
  }

  bounds(): Box | null {
    return this.map?.bounds ?? null;
  }

  private takePoses(poses: Pose[]): void {
    this.poses = poses;
    for (const pose of poses) {
      let trail = this.trails.get(pose.channel);
      if (!trail && this.trails.size >= kMaxTrails) continue;
      if (!trail) this.trails.set(pose.channel, (trail = { channel: pose.channel, points_m: [] }));
      extend(trail, pose);
    }
  }
}

function extend(trail: Trail, { x_m, y_m }: Pose): void {
  const points = trail.points_m;
  const last = points.length - 2;
  const moved_m = last < 0 ? Infinity : Math.hypot(x_m - points[last]!, y_m - points[last + 1]!);
  if (moved_m < kTrailStep_m) return;
  points.push(x_m, y_m);
  if (points.length > 2 * kMaxTrailPoints) thin(trail);
}

// Every second point of the older half goes.
function thin(trail: Trail): void {
  const half = kMaxTrailPoints; // points, so half of the numbers
  trail.points_m = trail.points_m.filter((_, k) => k >= half || k % 4 < 2);
}
