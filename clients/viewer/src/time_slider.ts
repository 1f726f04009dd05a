import { byId, setPressed, setText } from "./dom";
import { MapTimes } from "./frame";
import { isBeingMade, timeText } from "./words";

const kSteps = 1000; // of the slider; the last is now
const kMaking_ms = 300; // after which a map is said to be under way
const kPatience_ms = 500; // for it, before a newer time is asked for
const kOwn_ms = 1000; // the slider stays where the user moved it, then goes with other pages

// The slider over the time of the scans that a file keeps.
export class TimeSlider {
  private readonly slider = byId<HTMLInputElement>("time");
  private times: MapTimes | null = null;
  private utime: number | null = null; // where it stands; null: now
  private wish: number | null | undefined; // not sent yet
  private moved_ms = -Infinity;
  private sent_ms = -Infinity;
  private sendTimer = 0;
  private placeTimer = 0;
  private makingTimer = 0;

  constructor(private readonly onWish: (utime: number | null) => void) {
    this.slider.max = String(kSteps);
    this.slider.addEventListener("input", () => this.move());
    byId("time-now").addEventListener("click", () => {
      this.slider.value = String(kSteps);
      this.move();
    });
  }

  // Null: the map has no other times.
  show(times: MapTimes | null): void {
    if (times === this.times) return;
    const hasShown = times?.shown_utime !== this.times?.shown_utime;
    this.times = times;
    const hasTimes = times !== null && times.first_utime < times.last_utime;
    byId("times").hidden = !hasTimes;
    document.body.classList.toggle("has-times", hasTimes);
    this.place();
    this.showMaking(hasShown);
    this.send();
  }

  private move(): void {
    this.moved_ms = performance.now();
    this.utime = this.wish = this.utimeOf(this.slider.valueAsNumber);
    this.showText();
    this.send();
  }

  // The newest wish, but what is being made is to be seen while the slider moves on.
  private send(): void {
    clearTimeout(this.sendTimer);
    if (this.wish === undefined) return;
    const isMaking = this.times !== null && isBeingMade(this.times);
    const wait_ms = isMaking ? this.sent_ms + kPatience_ms - performance.now() : 0;
    if (wait_ms > 0) {
      this.sendTimer = window.setTimeout(() => this.send(), wait_ms);
      return;
    }
    this.onWish(this.wish);
    this.wish = undefined;
    this.sent_ms = performance.now();
  }

  // Where the server says.
  private place(): void {
    clearTimeout(this.placeTimer);
    const wait_ms = this.moved_ms + kOwn_ms - performance.now();
    if (wait_ms > 0) {
      this.placeTimer = window.setTimeout(() => this.place(), wait_ms);
      return;
    }
    this.utime = this.times?.wanted_utime ?? null;
    this.slider.value = String(this.stepOf(this.utime));
    this.showText();
  }

  private showText(): void {
    if (!this.times) return;
    const { first_utime, last_utime } = this.times;
    const hasTenths = last_utime - first_utime < kSteps * 1e6;
    const text = timeText(this.utime ?? last_utime, hasTenths);
    setText(byId("time-text"), text);
    this.slider.setAttribute("aria-valuetext", this.utime === null ? `Now, ${text}` : text);
    setPressed(byId("time-now"), this.utime === null);
  }

  private showMaking(hasShown: boolean): void {
    const isMaking = this.times !== null && isBeingMade(this.times);
    if (isMaking && this.makingTimer && !hasShown) return;
    clearTimeout(this.makingTimer);
    this.makingTimer = 0;
    const element = byId("time-making");
    if (!isMaking) setText(element, "");
    else this.makingTimer = window.setTimeout(() => setText(element, "Being made"), kMaking_ms);
  }

  private utimeOf(step: number): number | null {
    if (!this.times || step >= kSteps) return null;
    const { first_utime, last_utime } = this.times;
    return Math.round(first_utime + ((last_utime - first_utime) * step) / kSteps);
  }

  private stepOf(utime: number | null): number {
    if (!this.times || utime === null) return kSteps;
    const { first_utime, last_utime } = this.times;
    const part = (utime - first_utime) / (last_utime - first_utime);
    return Math.min(Math.round(kSteps * part), kSteps - 1);
  }
}
