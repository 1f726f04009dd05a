import { Api } from "./api";
import { Camera, Insets, Pixel, Point, View } from "./camera";
import { Card } from "./card";
import { Rgb, categoryColour, kMapColours } from "./colours";
import { Connection, ConnectionState, ViewRequest } from "./connection";
import { Choice, byId, setText } from "./dom";
import { Box, Frame } from "./frame";
import { Gestures } from "./gestures";
import { listenToKeys } from "./keyboard";
import { showLegend, showScaleBar } from "./legend";
import { LiveState } from "./live_state";
import { MapRenderer, ViewName } from "./map_renderer";
import { Overlay, Shown } from "./overlay";
import { Panels, showStatus } from "./panels";
import { SurfaceChoice } from "./surface_choice";
import { TestHook } from "./test_hook";
import { ThemeChoice } from "./theme";
import { TileStore } from "./tile_store";
import { TimeSlider } from "./time_slider";
import { ToolName, Tools } from "./tools";
import { Surface, boxInTiles, requestFor, serves } from "./view_request";
import { place, statusOf } from "./words";

const kViews: ViewName[] = ["probability", "log_odds", "contour", "gradient", "last_seen"];
const kRequest_ms = 120; // between two views that are asked for
const kAging_ms = 5000; // "last seen" fades by itself
const kArrowPan_px = 80;
const kZoomStep = 1.5;
const kNothingBox: Box = { x0_m: -10, y0_m: -10, x1_m: 10, y1_m: 10 };
const kSheet_px = 720; // narrower pages have the panel as a sheet at the bottom

class Viewer {
  private readonly token = new URLSearchParams(location.search).get("token") ?? "";
  private readonly api = new Api(this.token);
  private readonly live = new LiveState();
  private readonly camera = new Camera();
  private readonly store = new TileStore(() => this.requestMap());
  private readonly theme = new ThemeChoice(() => this.showTheme());
  private readonly surfaces = new SurfaceChoice(this.live);
  private readonly tools = new Tools(this.api, () => this.showTools());
  private readonly card = new Card((layer) => this.colourOf(layer));
  private readonly canvas = byId<HTMLCanvasElement>("map");
  private readonly renderer = new MapRenderer(this.canvas, this.store, () => this.requestMap());
  private readonly overlay = new Overlay(byId<HTMLCanvasElement>("overlay"), this.camera);
  private readonly panels: Panels;
  private readonly connection: Connection;
  private readonly timeSlider = new TimeSlider((utime) => this.connection.sendTime(utime));
  private readonly viewChoice = new Choice(byId("views"), "view", (v) =>
    this.setView(v as ViewName),
  );
  private readonly toolChoice = new Choice(byId("tools"), "tool", (t) =>
    this.tools.choose(t as ToolName),
  );
  private readonly sourceChoice = new Choice(byId("source"), "source", (s) => this.chooseSource(s));
  private readonly shown: Shown = { robots: true, trails: true, scans: true, paths: true };
  private view: ViewName = "probability";
  private connectionState: ConnectionState = "connecting";
  private follows = true; // the growth of the map, until the user moves
  private request: ViewRequest | null = null; // what the server was asked for last
  private requestTimer = 0;
  private mapName = "";
  private isMapDue = false;
  private isOverlayDue = false;
  private frameCount = 0;
  private lastError = "";
  private newest_utime_ms = 0; // of all tiles

  constructor() {
    this.panels = new Panels(this.live, {
      isChosen: (layer) => this.surfaces.isChosen(layer),
      onToggle: (layer) => this.changeSurfaces(() => this.surfaces.toggle(layer)),
      onMute: (layer, isMuted) => void this.mute(layer, isMuted),
      onFollow: (pose) =>
        this.moveTo({ ...this.camera.view, centre_x_m: pose.x_m, centre_y_m: pose.y_m }),
    });
    this.connection = new Connection(this.token, {
      onOpen: () => this.forget(),
      onFrame: (frame) => this.take(frame),
      onState: (state) => this.setConnectionState(state),
      onError: (text) => (this.lastError = text),
    });
    addEventListener("error", (event) => (this.lastError = event.message));
    addEventListener("unhandledrejection", (event) => (this.lastError = String(event.reason)));
    this.listen();
    this.showTheme();
    this.connection.connect();
    window.splinemapViewer = this.testHook();
  }

  // --- What comes from the server

  // It may be another server with another map.
  private forget(): void {
    this.store.forget();
    Object.assign(this.live, new LiveState());
    this.request = null;
    this.newest_utime_ms = 0;
    this.requestMap();
  }

  private take(frame: Frame): void {
    const { revision } = this.live.map ?? {};
    const before = this.live.times;
    if (frame.map && frame.map.name !== this.mapName) this.follows = true;
    this.mapName = frame.map?.name ?? this.mapName;
    const bounds = JSON.stringify(this.live.bounds());
    this.live.take(frame);
    const isOtherTime = before !== null && before.shown_utime !== this.live.times?.shown_utime;
    if (isOtherTime) this.follows = false; // the map is compared with that of before
    this.noteNewest(frame);
    this.store.take(frame);
    if (this.follows && (!this.request || JSON.stringify(this.live.bounds()) !== bounds))
      this.fit();
    if (isOtherTime || (frame.map && frame.map.revision !== revision)) this.tools.mapChanged();
    if (frame.layers && this.view === "last_seen") this.showSurfaces();
    this.askForView();
    this.showState();
    this.requestOverlay();
  }

  private noteNewest({ tiles }: Frame): void {
    for (const { changed_utime_ms } of tiles?.updates ?? []) {
      this.newest_utime_ms = Math.max(this.newest_utime_ms, changed_utime_ms);
    }
  }

  private setConnectionState(state: ConnectionState): void {
    this.connectionState = state;
    this.showState();
  }

  // Asks for the tiles of what is on the screen, now and then while it moves.
  private askForView(): void {
    if (this.requestTimer || !this.connection.isOpen() || !this.live.map) return;
    const { knot_interval_m } = this.live.map;
    const surfaces = this.surfaces.surfaces(this.view).map((name) => this.surface(name));
    const wanted = requestFor(this.camera, knot_interval_m, surfaces);
    if (this.request && serves(this.request, wanted, this.camera)) return;
    this.request = wanted;
    const { level } = wanted;
    this.store.ask(level, wanted.surfaces, boxInTiles(wanted, knot_interval_m, level));
    this.connection.sendView(wanted);
    this.requestTimer = window.setTimeout(() => {
      this.requestTimer = 0;
      this.askForView();
    }, kRequest_ms);
  }

  private surface(name: string): Surface {
    const { tiles, bounds } = this.live.layer(name) ?? this.live.map ?? { tiles: 0, bounds: null };
    return { name, tiles, bounds };
  }

  // --- Drawing: once for each frame of the screen in which something changed

  private requestMap(): void {
    this.isMapDue = true;
    this.requestOverlay();
  }

  private requestOverlay(): void {
    if (this.isOverlayDue) return;
    this.isOverlayDue = true;
    requestAnimationFrame(() => this.draw());
  }

  private draw(): void {
    this.isOverlayDue = false;
    if (this.isMapDue) this.drawMap();
    this.overlay.draw(this.live, this.tools, this.shown, this.theme.theme());
  }

  private drawMap(): void {
    this.isMapDue = false;
    ++this.frameCount;
    showScaleBar(this.camera);
    this.renderer.draw(this.camera, {
      view: this.view,
      colours: kMapColours[this.theme.theme()],
      knot_interval_m: this.live.map?.knot_interval_m ?? 1,
      colourOf: (surface) => (this.live.layer(surface) ? this.colourOf(surface) : [0, 0, 0]),
      now_utime_ms: Math.max(Date.now(), this.newest_utime_ms),
    });
  }

  private colourOf(layer: string): Rgb {
    return categoryColour(this.live.colourIndex("layer", layer), this.theme.theme());
  }

  // --- Moving

  private moved(): void {
    this.requestMap();
    this.askForView();
  }

  private movedByUser(): void {
    this.follows = false;
    this.moved();
  }

  private moveTo(view: View): void {
    this.camera.setView(view);
    this.movedByUser();
  }

  private zoom(factor: number): void {
    const { width_px, height_px } = this.camera;
    this.camera.zoomAt({ x_px: width_px / 2, y_px: height_px / 2 }, factor);
    this.movedByUser();
  }

  private pan(dx: number, dy: number): void {
    this.camera.panBy(dx * kArrowPan_px, dy * kArrowPan_px);
    this.movedByUser();
  }

  private fit(): void {
    this.camera.fit(this.live.bounds() ?? kNothingBox, this.insets());
    this.follows = true;
    this.moved();
  }

  // What the panel and the legend cover.
  private insets(): Insets {
    const isSheet = window.innerWidth < kSheet_px;
    const isOpen = document.body.classList.contains("panel-open");
    const right_px = isOpen && !isSheet ? byId("panel").offsetWidth + 12 : 0;
    return { left_px: 56, top_px: 0, right_px, bottom_px: isSheet ? 150 : 40 };
  }

  private resize(): void {
    const { width, height } = byId("stage").getBoundingClientRect();
    this.camera.width_px = wholePixels(width);
    this.camera.height_px = wholePixels(height);
    if (this.follows) this.fit();
    this.moved();
  }

  // --- Choosing

  private setView(view: ViewName): void {
    this.view = view;
    this.changeSurfaces(() => {});
  }

  private chooseSource(source: string): void {
    this.changeSurfaces(() => this.surfaces.chooseSource(source));
  }

  private changeSurfaces(change: () => void): void {
    change();
    this.showSurfaces();
    this.panels.show();
    this.moved();
  }

  private toggleShown(box: HTMLInputElement): void {
    this.shown[box.dataset.shown as keyof Shown] = box.checked;
    this.requestOverlay();
  }

  private togglePanel(): void {
    const isOpen = document.body.classList.toggle("panel-open");
    for (const id of ["panel-button", "panel-handle"]) {
      byId(id).setAttribute("aria-expanded", String(isOpen));
    }
    if (this.follows) this.fit();
  }

  private async mute(layer: string, isMuted: boolean): Promise<void> {
    try {
      await this.api.mute(layer, isMuted);
    } catch (error) {
      this.tools.error = error instanceof Error ? error.message : String(error);
      this.showTools();
    }
  }

  private escape(): void {
    if (!this.tools.clear()) this.tools.choose("inspect");
  }

  // --- Showing

  private showState(): void {
    const { map } = this.live;
    showStatus(statusOf(this.connectionState, this.live));
    setText(byId("map-name"), this.mapName);
    byId("map-name").title = this.mapName;
    this.timeSlider.show(this.live.times);
    for (const element of document.querySelectorAll<HTMLElement>(
      "[data-tool=goal], [data-commands]",
    )) {
      element.hidden = !map?.allows_commands;
    }
    this.panels.show();
  }

  private showTheme(): void {
    this.showSurfaces();
    this.requestMap();
  }

  private showSurfaces(): void {
    this.viewChoice.show(this.view);
    this.sourceChoice.show(this.surfaces.source());
    const [first] = this.surfaces.surfaces(this.view);
    const layerColour = first && first !== "sum" ? this.colourOf(first) : null;
    showLegend(this.view, kMapColours[this.theme.theme()], layerColour);
  }

  private showTools(): void {
    this.toolChoice.show(this.tools.active);
    this.canvas.dataset.tool = this.tools.active;
    this.card.show(this.tools);
    this.requestOverlay();
  }

  private showPosition(at: Pixel | null): void {
    const point = at && this.camera.toMap(at.x_px, at.y_px);
    setText(byId("position"), point ? `${place(point.x_m, point.y_m)} m` : "");
    this.tools.hover = point;
    if (this.tools.measured.length === 1 || this.tools.segment.length === 1) this.showTools();
  }

  // --- Listening

  private listen(): void {
    new Gestures(this.canvas, this.camera, {
      onMoved: () => this.movedByUser(),
      onClick: (at) => this.click(this.pointAt(at)),
      onHover: (at) => this.showPosition(at),
      takesDrags: () => this.tools.active === "goal",
      onDrag: (from, to) => this.tools.aim(this.goalBetween(from, to)),
      onDragEnd: (from, to) => {
        this.tools.aim(this.goalBetween(from, to));
        void this.tools.sendGoal();
      },
    });
    this.canvas.addEventListener("keydown", (event) => event.key === "Enter" && this.clickMiddle());
    this.listenToButtons();
    listenToKeys(this.keyActions());
    new ResizeObserver(() => this.resize()).observe(byId("stage"));
    if (window.innerWidth >= kSheet_px) document.body.classList.add("panel-open");
    setInterval(() => this.view === "last_seen" && this.requestMap(), kAging_ms);
  }

  private click(point: Point): void {
    this.tools.click(point, this.live.poses[0]);
  }

  // For those without a pointer.
  private clickMiddle(): void {
    const { centre_x_m, centre_y_m } = this.camera.view;
    this.click({ x_m: centre_x_m, y_m: centre_y_m });
  }

  private pointAt({ x_px, y_px }: Pixel): Point {
    return this.camera.toMap(x_px, y_px);
  }

  private goalBetween(from: Pixel, to: Pixel): Point & { yaw_rad: number } {
    const yaw_rad = Math.atan2(from.y_px - to.y_px, to.x_px - from.x_px);
    return { ...this.pointAt(from), yaw_rad };
  }

  private listenToButtons(): void {
    const help = byId<HTMLDialogElement>("help");
    const radius = byId<HTMLInputElement>("radius");
    const actions: Record<string, () => void> = {
      theme: () => this.theme.toggle(),
      "help-button": () => help.showModal(),
      "help-close": () => help.close(),
      "panel-button": () => this.togglePanel(),
      "panel-handle": () => this.togglePanel(),
      "zoom-in": () => this.zoom(kZoomStep),
      "zoom-out": () => this.zoom(1 / kZoomStep),
      fit: () => this.fit(),
      "card-close": () => this.tools.choose("inspect"),
    };
    for (const [id, action] of Object.entries(actions)) byId(id).addEventListener("click", action);
    radius.addEventListener("input", () => {
      if (radius.value !== "" && radius.validity.valid) this.tools.setRadius(radius.valueAsNumber);
    });
    for (const box of byId("shown").querySelectorAll("input")) {
      box.addEventListener("change", () => this.toggleShown(box));
    }
  }

  private keyActions(): Record<string, () => void> {
    const goal = () => this.live.map?.allows_commands && this.tools.choose("goal");
    const views = kViews.map((view, k) => [String(k + 1), () => this.setView(view)] as const);
    return {
      ...Object.fromEntries(views),
      "+": () => this.zoom(kZoomStep),
      "=": () => this.zoom(kZoomStep),
      "-": () => this.zoom(1 / kZoomStep),
      ArrowLeft: () => this.pan(1, 0),
      ArrowRight: () => this.pan(-1, 0),
      ArrowUp: () => this.pan(0, 1),
      ArrowDown: () => this.pan(0, -1),
      f: () => this.fit(),
      i: () => this.tools.choose("inspect"),
      m: () => this.tools.choose("measure"),
      s: () => this.tools.choose("segment"),
      g: () => void goal(),
      l: () => this.togglePanel(),
      t: () => this.theme.toggle(),
      "?": () => byId<HTMLDialogElement>("help").showModal(),
      Escape: () => this.escape(),
    };
  }

  private testHook(): TestHook {
    const viewer = this;
    return {
      get isConnected() {
        return viewer.connectionState === "open";
      },
      get isComplete() {
        return viewer.store.isComplete && !viewer.requestTimer;
      },
      get frameCount() {
        return viewer.frameCount;
      },
      get drawTime_ms() {
        return viewer.renderer.drawTime_ms;
      },
      get tileCount() {
        return viewer.store.tileCount();
      },
      get level() {
        return viewer.store.current.level;
      },
      get surfaces() {
        return viewer.store.current.surfaces;
      },
      get revision() {
        return viewer.live.map?.revision ?? 0;
      },
      get shownUtime() {
        return viewer.live.times?.shown_utime ?? null;
      },
      get lastError() {
        return viewer.lastError;
      },
      get view() {
        return { ...viewer.camera.view };
      },
      worldToPixel: (x_m, y_m) => viewer.camera.toPixel(x_m, y_m),
      pixelToWorld: (x_px, y_px) => viewer.camera.toMap(x_px, y_px),
      setView: (view) => viewer.moveTo(view),
      setViewName: (name) => viewer.setView(name),
      setTheme: (theme) => viewer.theme.choose(theme),
      readPixels: () => {
        viewer.drawMap();
        const { width, height } = viewer.canvas;
        return { width, height, data: viewer.renderer.readPixels() };
      },
    };
  }
}

// A side of the canvas as it is drawn: in whole pixels of the screen.
function wholePixels(side_px: number): number {
  return Math.max(Math.round(side_px * devicePixelRatio), 1) / devicePixelRatio;
}

try {
  new Viewer();
} catch (error) {
  const title = error instanceof Error ? error.message : String(error);
  showStatus({ tone: "bad", word: "Cannot draw", title, lines: [] });
}
