package splinemap.spy;

import java.util.ArrayList;
import java.util.HashMap;
import java.util.HashSet;
import java.util.LinkedHashMap;
import java.util.List;
import java.util.Map;
import java.util.Set;
import splinemap.layer_digest_t;
import splinemap.layer_listing_t;
import splinemap.layer_pull_t;
import splinemap.layer_ref_t;
import splinemap.layer_settings_t;
import splinemap.layer_updates_t;
import splinemap.settings_t;

/** The sum of all layers on a bus, as the settings say. Without sockets. Thread-safe. */
final class MapFollower {
  private static final int MAX_LAYERS = 256;
  private static final int MAX_SETTINGS = 1024;
  // Others tell settings when they are new, and when they are asked. Settings that fill several
  // messages may come in part, so they are asked for again.
  private static final long ASK_MS = 1000;
  private static final long ASK_AGAIN_MS = 30_000;
  private static final long MAX_SILENCE_MS = 3500;  // a layer that nobody speaks for is silent then
  // A layer of a name that another layer has taken is forgotten after that.
  private static final long FORGET_AFTER_MS = 10_000;
  // lcm-spy keeps half of its memory, whatever is on the bus. A tile may be kept three times.
  private static final int MAX_TILES = (int) Math.min(
      1 << 20, Runtime.getRuntime().maxMemory() / 2 / (3 * TileCodec.BYTES + 1024));

  private record LayerId(String name, long origin) {}

  private final long speaker;  // random bits of this follower
  private final Map<LayerId, LayerFollower> layers = new LinkedHashMap<>();
  private final Map<LayerId, LayerSettings> settings = new HashMap<>();
  private long heard_hash;  // of all settings that others know; 0 where there are none
  private long told_hash;   // of the last message that had settings
  private long asked_ms = Long.MIN_VALUE / 2;
  private layer_digest_t format;  // the first digest: its knot interval and limits hold for all
  private boolean has_other_formats;
  private final Map<Node, short[]> summed = new HashMap<>();
  private KnotBox touched = KnotBox.EMPTY;
  private boolean sums_anew;  // all tiles, since layers or settings have changed
  private long changed_ms;    // requires !summed.isEmpty()

  MapFollower(long speaker) {
    this.speaker = speaker;
  }

  synchronized void handleDigest(layer_digest_t digest, long now_ms) {
    if (digest.speaker == speaker) return;
    LayerFollower layer = findOrAdd(digest);
    if (layer == null) return;
    layer.handleDigest(digest, now_ms);
    if (layer.caughtUp()) forgetReplaced(id(digest.layer), now_ms);
  }

  private LayerFollower findOrAdd(layer_digest_t digest) {
    LayerId id = id(digest.layer);
    if (digest.protocol_version != 2 || settingsOf(id).isRemoved(digest.layer)) return null;
    if (format == null) format = digest;
    if (digest.knot_interval_m != format.knot_interval_m
        || digest.min_control_point != format.min_control_point
        || digest.max_control_point != format.max_control_point) {
      has_other_formats = true;
      return null;
    }
    if (!layers.containsKey(id) && layers.size() >= MAX_LAYERS) return null;
    return layers.computeIfAbsent(id, key -> new LayerFollower(this::isFull));
  }

  synchronized void handleSettings(settings_t message) {
    if (message.speaker == speaker) return;
    if (message.hash != 0) heard_hash = message.hash;
    if (message.num_layers > 0) told_hash = message.hash;
    for (layer_settings_t layer : message.layers) {
      LayerId id = new LayerId(layer.name, layer.origin);
      LayerSettings told = LayerSettings.of(layer);
      if (!told.isValid() || (!settings.containsKey(id) && settings.size() >= MAX_SETTINGS)) {
        continue;
      }
      LayerSettings merged = settingsOf(id).merge(told);
      sums_anew |= !merged.equals(settingsOf(id));
      settings.put(id, merged);
    }
    if (!sums_anew) return;
    layers.entrySet().removeIf(
        layer -> layer.getValue().isRemovedBy(settingsOf(layer.getKey())));
  }

  /** Whether to ask for settings now, by a message without any. Call it some times a second. */
  synchronized boolean asksForSettings(long now_ms) {
    long pause_ms = heard_hash == told_hash ? ASK_AGAIN_MS : ASK_MS;
    if (heard_hash == 0 || now_ms - asked_ms < pause_ms) return false;
    asked_ms = now_ms;
    return true;
  }

  synchronized void handleUpdates(layer_updates_t updates) {
    if (updates.speaker == speaker) return;
    LayerFollower layer = layers.get(id(updates.layer));
    if (layer != null) layer.handleUpdates(updates);
  }

  synchronized void handleListing(layer_listing_t listing, long now_ms) {
    if (listing.speaker == speaker) return;
    LayerFollower layer = layers.get(id(listing.layer));
    if (layer != null) layer.handleListing(listing, now_ms);
  }

  /** The pulls to publish now. Call it some times a second. */
  synchronized List<layer_pull_t> tick(long now_ms) {
    List<layer_pull_t> pulls = new ArrayList<>();
    for (LayerFollower layer : layers.values()) pulls.addAll(layer.tick(now_ms));
    for (layer_pull_t pull : pulls) pull.speaker = speaker;
    return pulls;
  }

  /** Sums what has changed; false where nothing has. */
  synchronized boolean refresh(long now_ms) {
    Set<Node> changed = new HashSet<>();
    layers.forEach((id, layer) -> {
      LayerSettings setting = settingsOf(id);
      Set<Node> of_layer = layer.takeChanged();
      for (Node tile : sums_anew ? layer.tiles() : of_layer) {
        changed.addAll(TileRows.keysOfShifted(tile, setting.shift_i(), setting.shift_j()));
      }
    });
    boolean is_new = sums_anew || !changed.isEmpty();
    boolean shrinks = sums_anew;
    if (sums_anew) summed.clear();
    sums_anew = false;
    for (Node tile : changed) {
      short[] points = sumOfLayers(tile);
      if (points == null) {
        shrinks |= summed.remove(tile) != null;
      } else {
        summed.put(tile, points);
        touched = touched.with(tile, points);
      }
    }
    if (shrinks) {
      touched = KnotBox.EMPTY;
      summed.forEach((tile, points) -> touched = touched.with(tile, points));
    }
    if (is_new) changed_ms = now_ms;
    return is_new;
  }

  /** Control points of the map, row-major, 1/256 log-odds, 0 for unknown; null for no tile. */
  synchronized short[] points(Node tile) {
    return summed.get(tile);
  }

  synchronized KnotBox touched() {
    return touched;
  }

  synchronized double knotIntervalM() {
    return format == null ? 1 : format.knot_interval_m;
  }

  /** The surface at a point, in log-odds; NaN where it is unknown. */
  synchronized double logOdds(double x_m, double y_m) {
    double x = x_m / knotIntervalM();
    SurfaceRow surface = new SurfaceRow(this, x, x);
    surface.moveTo(y_m / knotIntervalM());
    return surface.at(x);
  }

  /** A line of text about the layers. */
  synchronized String status(long now_ms) {
    if (layers.isEmpty()) return "No daemon was heard yet";
    long match_ms = now_ms;
    long spoken_for_ms = now_ms;
    for (LayerFollower layer : layers.values()) {
      match_ms = Math.min(match_ms, layer.lastMatchMs());
      spoken_for_ms = Math.min(spoken_for_ms, layer.lastSpokenForMs());
    }
    String text = layers.size() == 1 ? "1 layer, " : layers.size() + " layers, ";
    long muted = layers.keySet().stream().filter(id -> !settingsOf(id).isSummed()).count();
    if (muted > 0) text += muted + " muted, ";
    text += summed.size() + " tiles";
    // While much changes, the layers seldom match a digest.
    text += match_ms > spoken_for_ms - MAX_SILENCE_MS ? ", caught up" : ", behind";
    if (!summed.isEmpty()) text += ", changed " + age(now_ms - changed_ms) + " ago";
    if (now_ms - spoken_for_ms > MAX_SILENCE_MS) {
      text += ", silent for " + age(now_ms - spoken_for_ms);
    }
    if (isFull()) text += ", no memory for more";
    if (has_other_formats) text += ", without layers of another knot interval or limits";
    return text;
  }

  private static String age(long ms) {
    return ms < 10_000 ? String.format("%.1f s", ms / 1000.0) : ms / 1000 + " s";
  }

  private static LayerId id(layer_ref_t layer) {
    return new LayerId(layer.name, layer.origin);
  }

  private LayerSettings settingsOf(LayerId id) {
    return settings.getOrDefault(id, LayerSettings.NONE);
  }

  private boolean isFull() {
    return layers.values().stream().mapToInt(LayerFollower::numTilesKept).sum() >= MAX_TILES;
  }

  // The robot has started a new map.
  private void forgetReplaced(LayerId heard, long now_ms) {
    layers.entrySet().removeIf(entry -> {
      LayerId id = entry.getKey();
      boolean is_replaced = id.name.equals(heard.name) && id.origin != heard.origin
          && now_ms - entry.getValue().lastSpokenForMs() > FORGET_AFTER_MS;
      sums_anew |= is_replaced;
      return is_replaced;
    });
  }

  // The layers of low weight count together as one layer that is not sure.
  private short[] sumOfLayers(Node tile) {
    List<short[]> parts = new ArrayList<>();
    List<short[]> low_weight_parts = new ArrayList<>();
    layers.forEach((id, layer) -> {
      LayerSettings setting = settingsOf(id);
      if (!setting.isSummed()) return;
      short[] points =
          TileRows.shifted(layer::points, tile, setting.shift_i(), setting.shift_j());
      if (points != null) (setting.low_weight() ? low_weight_parts : parts).add(points);
    });
    int min = format.min_control_point;
    int max = format.max_control_point;
    if (!low_weight_parts.isEmpty()) parts.add(sum(low_weight_parts, min * 4 / 5, max * 4 / 5));
    if (parts.size() <= 1) return parts.isEmpty() ? null : parts.get(0);
    return sum(parts, min, max);
  }

  // 1 where layers that know the place add up to 0.
  private static short[] sum(List<short[]> parts, int min, int max) {
    short[] summed = new short[TileCodec.SIDE * TileCodec.SIDE];
    for (int k = 0; k < summed.length; ++k) {
      int sum = 0;
      boolean is_known = false;
      for (short[] part : parts) {
        sum += part[k];
        is_known |= part[k] != 0;
      }
      sum = Math.max(min, Math.min(sum, max));
      summed[k] = (short) (is_known && sum == 0 ? 1 : sum);
    }
    return summed;
  }
}
