import { LiveState } from "./live_state";
import { ViewName } from "./map_renderer";

const kMaxSurfaces = 32; // that the server takes at once

// Whether the map is drawn, or layers that were chosen; nothing chosen is the map.
export class SurfaceChoice {
  private readonly chosen = new Set<string>();
  private isMap = true;

  constructor(private readonly live: LiveState) {}

  source(): "map" | "layers" {
    return this.isMap ? "map" : "layers";
  }

  isChosen(layer: string): boolean {
    return !this.isMap && this.chosen.has(layer);
  }

  chooseSource(source: string): void {
    this.isMap = source === "map";
    if (this.isMap) return;
    this.chosen.clear();
    for (const layer of this.summed()) this.chosen.add(layer);
    this.isMap = this.chosen.size === 0;
  }

  // The first that is chosen replaces the map.
  toggle(layer: string): void {
    if (this.isMap) this.chosen.clear();
    if (!this.chosen.delete(layer)) this.chosen.add(layer);
    this.isMap = this.chosen.size === 0;
  }

  forget(): void {
    this.chosen.clear();
    this.isMap = true;
  }

  // What to ask the server for.
  surfaces(view: ViewName): string[] {
    if (this.isMap && view !== "last_seen") return ["sum"];
    const layers = this.isMap ? this.summed() : this.chosenNow();
    return layers.length > 0 ? layers.slice(0, kMaxSurfaces) : ["sum"];
  }

  private summed(): string[] {
    const shown = this.live.layers.filter((layer) => !layer.is_muted && layer.state !== "removed");
    return shown.map((layer) => layer.key);
  }

  private chosenNow(): string[] {
    return this.live.layers.map((layer) => layer.key).filter((key) => this.chosen.has(key));
  }
}
