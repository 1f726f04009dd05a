import { Api, CheckAnswer, QueryAnswer } from "./api";
import { Point } from "./camera";

export type ToolName = "inspect" | "measure" | "segment" | "goal";

const kRefresh_ms = 1000;

// What the tools have marked on the map, and the server's answers to it. They are asked for again
// when the map changed, once a second at most.
export class Tools {
  active: ToolName = "inspect";
  inspected: Point | null = null;
  measured: Point[] = [];
  segment: Point[] = [];
  goal: (Point & { yaw_rad: number }) | null = null;
  hover: Point | null = null;
  radius_m = 0.2;
  sample: QueryAnswer | null = null;
  check: CheckAnswer | null = null;
  isGoalSent = false;
  error = "";
  private refreshTimer = 0;
  private asked = 0;

  constructor(
    private readonly api: Api,
    private readonly onChange: () => void,
  ) {}

  choose(tool: ToolName): void {
    this.clear();
    this.active = tool;
    this.onChange();
  }

  // True where something was marked.
  clear(): boolean {
    const wasMarked = this.hasMarks();
    this.inspected = this.goal = this.sample = this.check = null;
    this.measured = [];
    this.segment = [];
    this.isGoalSent = false;
    this.error = "";
    ++this.asked;
    this.onChange();
    return wasMarked;
  }

  hasMarks(): boolean {
    return Boolean(this.inspected || this.measured[0] || this.segment[0] || this.goal);
  }

  click(point: Point, robot: Point | undefined): void {
    switch (this.active) {
      case "inspect":
        this.inspected = point;
        this.sample = null;
        break;
      case "measure":
        this.measured = withNext(this.measured, point);
        break;
      case "segment":
        this.segment = withNext(this.segment, point);
        this.check = null;
        break;
      case "goal": {
        const yaw_rad = robot ? Math.atan2(point.y_m - robot.y_m, point.x_m - robot.x_m) : 0;
        this.aim({ ...point, yaw_rad });
        void this.sendGoal();
      }
    }
    void this.ask();
    this.onChange();
  }

  aim(goal: Point & { yaw_rad: number }): void {
    this.goal = goal;
    this.isGoalSent = false;
    this.onChange();
  }

  // One goal for each press of the button: the tool ends, so that no robot starts by mistake.
  async sendGoal(): Promise<void> {
    const { goal } = this;
    if (!goal) return;
    this.active = "inspect";
    this.error = "";
    try {
      await this.api.sendGoal(goal.x_m, goal.y_m, goal.yaw_rad);
      if (goal === this.goal) this.isGoalSent = true;
    } catch (error) {
      this.error = messageOf(error);
    }
    this.onChange();
  }

  setRadius(radius_m: number): void {
    this.radius_m = radius_m;
    this.check = null;
    void this.ask();
    this.onChange();
  }

  mapChanged(): void {
    if (this.refreshTimer || (!this.inspected && this.segment.length < 2)) return;
    this.refreshTimer = window.setTimeout(() => {
      this.refreshTimer = 0;
      void this.ask();
    }, kRefresh_ms);
  }

  private async ask(): Promise<void> {
    const asked = ++this.asked;
    const { inspected, segment } = this;
    try {
      const sample = inspected && (await this.api.query(inspected.x_m, inspected.y_m));
      const check = segment.length === 2 ? await this.askCheck(segment[0]!, segment[1]!) : null;
      if (asked !== this.asked) return; // somebody clicked on
      Object.assign(this, { sample, check, error: "" });
    } catch (error) {
      if (asked === this.asked) this.error = messageOf(error);
    }
    this.onChange();
  }

  private askCheck(from: Point, to: Point): Promise<CheckAnswer> {
    return this.api.check(from.x_m, from.y_m, to.x_m, to.y_m, this.radius_m);
  }
}

// Two points; the third begins anew.
function withNext(points: Point[], next: Point): Point[] {
  return points.length >= 2 ? [next] : [...points, next];
}

export function lengthOf([from, to]: Point[]): number {
  return from && to ? Math.hypot(to.x_m - from.x_m, to.y_m - from.y_m) : 0;
}

function messageOf(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}
