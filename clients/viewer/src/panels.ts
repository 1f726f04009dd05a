import { categoryColour } from "./colours";
import { RowList, byId, make, setPressed, setText, swatch } from "./dom";
import { Daemon, Layer, Pose } from "./frame";
import { LiveState } from "./live_state";
import * as words from "./words";

interface Handlers {
  isChosen(layer: string): boolean;
  onToggle(layer: string): void;
  onMute(layer: string, isMuted: boolean): void;
  onFollow(pose: Pose): void;
}

// The lists at the side: layers, robots, daemons.
export class Panels {
  private readonly layers: RowList<Layer>;
  private readonly robots: RowList<Pose>;
  private readonly daemons: RowList<Daemon>;

  constructor(
    private readonly live: LiveState,
    private readonly handlers: Handlers,
  ) {
    this.layers = new RowList(byId("layers"), (layer) => this.layerRow(layer), "No layers yet");
    this.robots = new RowList(byId("robots"), (pose) => this.robotRow(pose), "No pose was heard");
    this.daemons = new RowList(byId("daemons"), () => daemonRow(), "None is heard");
  }

  show(): void {
    const { live } = this;
    this.layers.show(live.layers, (layer) => layer.key);
    this.robots.show(live.poses, (pose) => pose.channel);
    this.daemons.show(live.daemons, (daemon) => daemon.key);
    showNotes(
      byId("refused"),
      (live.map?.refused ?? []).map((why) => `Not followed: ${why}`),
    );
    const isBus = !live.map || live.map.source === "bus";
    byId("daemons-section").hidden = !isBus;
    byId("robots-section").hidden = !isBus && live.poses.length === 0;
    setText(byId("map-figures"), figures(live));
    setText(byId("panel-summary"), summary(live));
  }

  private layerRow(layer: Layer) {
    const colour = categoryColour(this.live.colourIndex("layer", layer.key));
    const element = make("li", "row");
    const box = make("input");
    box.type = "checkbox";
    box.addEventListener("change", () => this.handlers.onToggle(layer.key));
    const name = make("span", "name");
    const label = make("label", "row-label");
    label.append(box, swatch(colour), name);
    const mute = make("button", "mute");
    mute.type = "button";
    mute.addEventListener("click", () =>
      this.handlers.onMute(layer.key, !isMuted(this.live, layer.key)),
    );
    const state = make("span", "state");
    const figuresText = make("span", "detail");
    element.append(label, mute, state, figuresText);
    const update = (now: Layer) => {
      setText(name, now.name);
      setText(state, words.layerState(now));
      setText(figuresText, words.layerFigures(now));
      element.dataset.state = now.state;
      box.checked = this.handlers.isChosen(now.key);
      box.setAttribute("aria-label", `Draw the layer ${now.name}`);
      mute.hidden = !this.live.map?.allows_commands || now.state === "removed";
      setText(mute, now.is_muted ? "Unmute" : "Mute");
      mute.setAttribute("aria-label", `${now.is_muted ? "Unmute" : "Mute"} ${now.name}`);
      setPressed(mute, now.is_muted);
    };
    return { element, update };
  }

  private robotRow(pose: Pose) {
    const colour = categoryColour(this.live.colourIndex("channel", pose.channel));
    const element = make("li", "row");
    const label = make("span", "row-label");
    const name = make("span", "name");
    label.append(swatch(colour), name);
    const show = make("button", "mute", "Show");
    show.type = "button";
    let newest = pose;
    show.addEventListener("click", () => this.handlers.onFollow(newest));
    const where = make("span", "detail figures-in-line");
    element.append(label, show, where);
    const update = (now: Pose) => {
      newest = now;
      setText(name, now.channel);
      show.setAttribute("aria-label", `Show ${now.channel}`);
      const heard =
        now.heard_s_ago > words.kDaemonSilent_s
          ? ` · heard ${words.duration(now.heard_s_ago)} ago`
          : "";
      setText(where, `${words.place(now.x_m, now.y_m)} m · ${words.degrees(now.yaw_rad)}${heard}`);
    };
    return { element, update };
  }
}

function isMuted(live: LiveState, key: string): boolean {
  return live.layer(key)?.is_muted ?? false;
}

function daemonRow() {
  const element = make("li", "row daemon");
  const name = make("span", "name");
  const state = make("span", "state");
  const figuresText = make("span", "detail");
  const drops = make("span", "detail");
  const notes = make("ul", "notes");
  element.append(name, state, figuresText, drops, notes);
  const update = (daemon: Daemon) => {
    const isGone = daemon.heard_s_ago > words.kDaemonSilent_s;
    setText(name, daemon.name);
    setText(state, isGone ? `silent for ${words.duration(daemon.heard_s_ago)}` : versionOf(daemon));
    setText(figuresText, daemonFigures(daemon));
    element.dataset.state = isGone ? "gone" : "live";
    setText(drops, daemonDrops(daemon));
    showNotes(notes, daemonNotes(daemon));
  };
  return { element, update };
}

function versionOf({ version, uptime_s }: Daemon): string {
  return `${version} · up ${words.duration(uptime_s)}`;
}

function daemonFigures(daemon: Daemon): string {
  const mapped = daemon.scans_mapped.toLocaleString("en");
  const received = words.countOf(daemon.scans_received, "scan");
  const scans = daemon.scans_received > 0 ? `${mapped} of ${received} mapped` : "No scans";
  const unsaved = daemon.revision - daemon.saved_revision;
  return `${scans} · ${unsaved > 0 ? `${unsaved.toLocaleString("en")} not yet saved` : "saved"}`;
}

function daemonDrops(daemon: Daemon): string {
  const drops = daemon.drops.filter(({ count }) => count > 0);
  const phrases = drops.map(({ reason, count }) => `${count} ${words.dropPhrase(reason)}`);
  return phrases.length > 0 ? `Dropped: ${phrases.join(", ")}` : "";
}

function daemonNotes(daemon: Daemon): string[] {
  const problems = daemon.problems.filter(({ count }) => count > 0);
  const sentences = problems.map(
    ({ name, count }) => words.problemSentence(name) + (count > 1 ? ` ${count} times.` : ""),
  );
  return daemon.last_problem ? [...sentences, `Newest: ${daemon.last_problem}`] : sentences;
}

function showNotes(list: HTMLElement, notes: string[]): void {
  if (list.dataset.shown === notes.join("\n")) return;
  list.dataset.shown = notes.join("\n");
  list.replaceChildren(...notes.map((note) => make("li", "", note)));
}

function figures({ map }: LiveState): string {
  if (!map) return "";
  const knots = `${Number((100 * map.knot_interval_m).toFixed(2))} cm knots`;
  return [words.countOf(map.tiles, "tile"), knots, `viewer ${map.version}`].join(" · ");
}

function summary({ layers, poses }: LiveState): string {
  return `${words.countOf(layers.length, "layer")} · ${words.countOf(poses.length, "robot")}`;
}

// The pill in the bar and the banner over the map.
export function showStatus(status: words.Status): void {
  const pill = byId("status");
  setText(pill, status.word);
  pill.dataset.tone = status.tone;
  const banner = byId("banner");
  banner.hidden = !status.title && status.lines.length === 0;
  banner.dataset.tone = status.tone;
  setText(byId("banner-title"), status.title);
  showNotes(byId("banner-lines"), status.lines);
}
