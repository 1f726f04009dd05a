package splinemap.spy;

import java.util.ArrayList;
import java.util.HashMap;
import java.util.HashSet;
import java.util.LinkedHashMap;
import java.util.List;
import java.util.Map;
import java.util.Set;
import splinemap.layer_digest_t;
import splinemap.layer_epoch_t;
import splinemap.layer_listing_t;
import splinemap.layer_pull_t;
import splinemap.layer_updates_t;

/** The sum of all layers on a bus, as far as it has come. Thread-safe. */
final class MapCopy {
  private static final int MAX_LAYERS = 64;
  private static final long MAX_SILENCE_MS = 3500;  // who says nothing for so long is gone
  // A layer of a name that another one has taken is forgotten after that.
  private static final long FORGET_AFTER_MS = 10_000;
  // Whatever is on the bus, lcm-spy keeps half of its memory: a tile may be there three times.
  private static final int MAX_TILES = (int) Math.min(
      1 << 20, Runtime.getRuntime().maxMemory() / 2 / (3 * TileCode.BYTES + 1024));

  private record LayerId(String name, long origin) {}

  private final Map<LayerId, LayerCopy> layers = new LinkedHashMap<>();
  private layer_digest_t format;  // the first digest: its knot interval and limits hold for all
  private boolean has_other_formats;
  private final Map<Node, short[]> merged = new HashMap<>();
  private KnotBox touched = KnotBox.EMPTY;
  private final Set<Node> forgotten = new HashSet<>();  // tiles of layers that were
  private long changed_ms;                              // requires !merged.isEmpty()

  synchronized void takeDigest(layer_digest_t digest, long now_ms) {
    if (digest.protocol_version != 1) return;
    if (format == null) format = digest;
    if (digest.knot_interval_m != format.knot_interval_m
        || digest.min_control_point != format.min_control_point
        || digest.max_control_point != format.max_control_point) {
      has_other_formats = true;
      return;
    }
    LayerId id = id(digest.layer);
    if (!layers.containsKey(id) && layers.size() >= MAX_LAYERS) return;
    LayerCopy layer = layers.computeIfAbsent(id, key -> new LayerCopy(this::isFull));
    layer.takeDigest(digest, now_ms);
    if (layer.inSync()) forgetReplaced(id, now_ms);
  }

  synchronized void takeUpdates(layer_updates_t updates) {
    LayerCopy layer = layers.get(id(updates.layer));
    if (layer != null) layer.takeUpdates(updates);
  }

  synchronized void takeListing(layer_listing_t listing, long now_ms) {
    LayerCopy layer = layers.get(id(listing.layer));
    if (layer != null) layer.takeListing(listing, now_ms);
  }

  synchronized List<layer_pull_t> pulls(long now_ms) {
    List<layer_pull_t> pulls = new ArrayList<>();
    for (LayerCopy layer : layers.values()) pulls.addAll(layer.pulls(now_ms));
    return pulls;
  }

  /** Merges what has come; true where something has. */
  synchronized boolean refresh(long now_ms) {
    Set<Node> changed = new HashSet<>(forgotten);
    forgotten.clear();
    for (LayerCopy layer : layers.values()) changed.addAll(layer.takeChanged());
    boolean shrinks = false;
    for (Node tile : changed) {
      short[] points = mergedPoints(tile);
      if (points == null) {
        shrinks |= merged.remove(tile) != null;
      } else {
        merged.put(tile, points);
        touched = touched.with(tile, points);
      }
    }
    if (shrinks) {
      touched = KnotBox.EMPTY;
      merged.forEach((tile, points) -> touched = touched.with(tile, points));
    }
    if (!changed.isEmpty()) changed_ms = now_ms;
    return !changed.isEmpty();
  }

  /** Control points of the map, row-major, 1/256 log-odds, 0 for never seen; null for no tile. */
  synchronized short[] points(Node tile) {
    return merged.get(tile);
  }

  synchronized KnotBox touched() {
    return touched;
  }

  synchronized double knotIntervalM() {
    return format == null ? 1 : format.knot_interval_m;
  }

  /** The surface at a point, in log-odds; NaN where it was never seen. */
  synchronized double logOdds(double x_m, double y_m) {
    double x = x_m / knotIntervalM();
    SurfaceRow surface = new SurfaceRow(this, x, x);
    surface.moveTo(y_m / knotIntervalM());
    return surface.at(x);
  }

  /** What there is, in words. */
  synchronized String status(long now_ms) {
    if (layers.isEmpty()) return "No daemon was heard yet";
    long match_ms = now_ms;
    long heard_ms = now_ms;
    for (LayerCopy layer : layers.values()) {
      match_ms = Math.min(match_ms, layer.matchMs());
      heard_ms = Math.min(heard_ms, layer.heardMs());
    }
    String layers_text = layers.size() == 1 ? "1 layer, " : layers.size() + " layers, ";
    String text = layers_text + merged.size() + " tiles";
    // While much changes, a digest is seldom the same as what is there.
    text += match_ms > Math.min(heard_ms, now_ms) - MAX_SILENCE_MS ? ", whole" : ", not yet whole";
    if (!merged.isEmpty()) text += ", changed " + age(now_ms - changed_ms) + " ago";
    if (now_ms - heard_ms > MAX_SILENCE_MS) text += ", silent for " + age(now_ms - heard_ms);
    if (isFull()) text += ", no memory for more";
    if (has_other_formats) text += ", without layers of another knot interval or limits";
    return text;
  }

  private static String age(long ms) {
    return ms < 10_000 ? String.format("%.1f s", ms / 1000.0) : ms / 1000 + " s";
  }

  private static LayerId id(layer_epoch_t layer) {
    return new LayerId(layer.name, layer.origin);
  }

  private boolean isFull() {
    return layers.values().stream().mapToInt(LayerCopy::numTilesKept).sum() >= MAX_TILES;
  }

  // The robot has begun another map.
  private void forgetReplaced(LayerId speaker, long now_ms) {
    layers.entrySet().removeIf(entry -> {
      LayerId id = entry.getKey();
      boolean is_replaced = id.name.equals(speaker.name) && id.origin != speaker.origin
          && now_ms - entry.getValue().heardMs() > FORGET_AFTER_MS;
      if (is_replaced) forgotten.addAll(entry.getValue().tiles());
      return is_replaced;
    });
  }

  // Sums within the limits; 1 where layers that know the place add up to 0.
  private short[] mergedPoints(Node tile) {
    List<short[]> parts = new ArrayList<>();
    for (LayerCopy layer : layers.values()) {
      short[] points = layer.points(tile);
      if (points != null) parts.add(points);
    }
    if (parts.size() <= 1) return parts.isEmpty() ? null : parts.get(0);
    short[] merged = new short[TileCode.SIDE * TileCode.SIDE];
    for (int k = 0; k < merged.length; ++k) {
      int sum = 0;
      boolean is_known = false;
      for (short[] part : parts) {
        sum += part[k];
        is_known |= part[k] != 0;
      }
      sum = Math.max(format.min_control_point, Math.min(sum, format.max_control_point));
      merged[k] = (short) (is_known && sum == 0 ? 1 : sum);
    }
    return merged;
  }
}
