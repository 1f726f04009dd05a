package splinemap.spy;

import java.util.ArrayList;
import java.util.HashMap;
import java.util.HashSet;
import java.util.LinkedHashMap;
import java.util.List;
import java.util.Map;
import java.util.Random;
import java.util.Set;
import java.util.function.BooleanSupplier;
import splinemap.layer_digest_t;
import splinemap.layer_epoch_t;
import splinemap.layer_listing_t;
import splinemap.layer_pull_t;
import splinemap.layer_updates_t;
import splinemap.node_listing_t;
import splinemap.stand_in_digest_t;
import splinemap.tile_update_t;

/**
 * The follower's side of the protocol for one layer as it was mapped: a copy of what its owner has
 * published, made of whatever messages arrive. lcmtypes/README.md has the rules. Without what a
 * client may leave out: waiting for others' pulls, tiles of an older life, coarser levels.
 */
final class LayerCopy {
  private static final int MAX_BACK_OFF_MS = 100;  // what is on its way will mostly be there then
  private static final int RETRY_MS = 300;
  private static final int MAX_ASKS = 32;
  private static final int MAX_ASKED_AT_ONCE = 256;
  private static final int NODES_PER_PULL = 100;
  private static final int MAX_WANTED = 8192;
  private static final int MAX_LATE_US = 5_000_000;
  private static final long MAX_SILENCE_MS = 3000;  // of an owner; then others stand in for it
  // A life that nobody speaks of any more, and that was never whole, is given up.
  private static final long GIVE_UP_LIFE_MS = 10_000;
  // One digest may be a mistake, or a lie: a life counts after it was spoken of for so long, and is
  // given up sooner before.
  private static final long PROBATION_MS = 2000;
  private static final long GIVE_UP_ON_PROBATION_MS = 3500;
  private static final long MAX_AHEAD = 1 << 20;  // commits that an owner pushes between digests

  private static final long NEVER_MS = Long.MIN_VALUE / 2;

  private record Tile(short[] points, long revision, long checksum) {}

  private static final class Wanted {
    long due_ms;
    long revision;  // of a tile: that one or a newer
    int times_asked;
  }

  private final BooleanSupplier is_full;  // no tile more is to be kept
  private final Random random = new Random();
  private layer_epoch_t life;     // of the owner
  private layer_digest_t digest;  // the last of this life
  private layer_digest_t owners_digest;  // the last of these, and of who stands in
  private stand_in_digest_t stand_in_digest;
  private Map<Node, Tile> tiles = new HashMap<>();
  private final Map<Node, Long> hashes = new HashMap<>();  // sums of the tiles' checksums
  private long hash;                                       // of all of them
  // Of the tiles that changed since the last digest, what was there then; null for nothing.
  private final Map<Node, Tile> at_digest = new HashMap<>();
  private Map<Node, Tile> previous;  // what the life before left: shown until this one is whole
  private layer_epoch_t previous_life;
  private long life_since_ms;
  private long hash_of_last_check;
  private final Map<Node, Wanted> wanted = new LinkedHashMap<>();
  private layer_digest_t check;  // whose hashes are compared until nothing of it is wanted
  private boolean in_sync;
  private Set<Node> changed = new HashSet<>();
  private long heard_ms = NEVER_MS;  // the owner
  private long spoken_for_ms = NEVER_MS;
  private long match_ms = NEVER_MS;

  LayerCopy(BooleanSupplier is_full) {
    this.is_full = is_full;
  }

  /** Whether all that the last digest told of is there. */
  boolean inSync() {
    return in_sync;
  }

  /** When that was so for the last time, and when the owner or who stands in for it was heard. */
  long matchMs() {
    return match_ms;
  }

  long spokenForMs() {
    return spoken_for_ms;
  }

  int numTilesKept() {
    return tiles.size() + (previous == null ? 0 : previous.size());
  }

  /** The control points that are to be shown, row-major; null where there are none. */
  short[] points(Node tile) {
    Tile found = shown().get(tile);
    return found == null ? null : found.points;
  }

  /** The tiles to be shown anew since this was asked last. */
  Set<Node> takeChanged() {
    Set<Node> taken = changed;
    changed = new HashSet<>();
    return taken;
  }

  Set<Node> tiles() {
    return shown().keySet();
  }

  void takeDigest(layer_digest_t digest, long now_ms) {
    if (!reachesLife(digest.layer, now_ms)) return;
    heard_ms = now_ms;
    spoken_for_ms = now_ms;
    if (digest.layer.detail_level != 0) return;
    if (owners_digest != null && wasOvertaken(digest, owners_digest)) return;
    owners_digest = digest;
    compareWith(digest, now_ms);
  }

  /** Ignored as long as the owner itself speaks. */
  void takeStandInDigest(stand_in_digest_t stand_in, long now_ms) {
    layer_digest_t digest = stand_in.digest;
    boolean is_of_this_life = life != null && compareLives(digest.layer, life) == 0;
    if (is_of_this_life && now_ms - heard_ms <= MAX_SILENCE_MS) return;
    if (!reachesLife(digest.layer, now_ms)) return;
    spoken_for_ms = now_ms;
    if (digest.layer.detail_level != 0) return;
    // Of two that stand in, neither is late: their states are different ones.
    if (stand_in_digest != null && stand_in_digest.daemon_nonce == stand_in.daemon_nonce
        && isNoLater(digest, stand_in_digest.digest)) {
      return;
    }
    stand_in_digest = stand_in;
    compareWith(digest, now_ms);
  }

  /** True where nothing is left: lives up to some incarnation are gone for good. */
  boolean isRemovedBy(LayerControl control) {
    if (previous != null && control.isRemoved(previous_life)) forgetPrevious();
    return control.isRemoved(life);
  }

  void takeUpdates(layer_updates_t updates) {
    if (!isOfThisLife(updates.layer) || digest == null) return;
    for (tile_update_t update : updates.tiles) apply(update);
  }

  void takeListing(layer_listing_t listing, long now_ms) {
    if (!isOfThisLife(listing.layer) || check == null || listing.state < check.state) return;
    for (node_listing_t node : listing.nodes) takeNode(node, now_ms);
  }

  /** What is to be asked now. Call it some times a second. */
  List<layer_pull_t> pulls(long now_ms) {
    long give_up_ms = isOnProbation() ? GIVE_UP_ON_PROBATION_MS : GIVE_UP_LIFE_MS;
    if (previous != null && now_ms - spoken_for_ms > give_up_ms) goBackALife();
    if (digest != null && !in_sync) lookForMatch(now_ms);
    if (wanted.values().removeIf(node -> node.times_asked >= MAX_ASKS && node.due_ms <= now_ms)) {
      giveUpCheck();  // a later digest finds it again
    }
    List<Node> asked = new ArrayList<>();
    long room = MAX_ASKED_AT_ONCE
        - wanted.values().stream().filter(n -> n.times_asked > 0 && n.due_ms > now_ms).count();
    for (Map.Entry<Node, Wanted> entry : wanted.entrySet()) {
      if (asked.size() >= room) break;
      Wanted node = entry.getValue();
      if (node.due_ms > now_ms) continue;
      asked.add(entry.getKey());
      node.due_ms = now_ms + RETRY_MS + random.nextInt(RETRY_MS);
      ++node.times_asked;
    }
    List<layer_pull_t> pulls = new ArrayList<>();
    for (int k = 0; k < asked.size(); k += NODES_PER_PULL) {
      pulls.add(pullOf(asked.subList(k, Math.min(k + NODES_PER_PULL, asked.size()))));
    }
    return pulls;
  }

  private Map<Node, Tile> shown() {
    return previous != null ? previous : tiles;
  }

  // False for a life that is over.
  private boolean reachesLife(layer_epoch_t layer, long now_ms) {
    int order = life == null ? 1 : compareLives(layer, life);
    if (order > 0) beginLife(layer, now_ms);
    return order >= 0;
  }

  private boolean isOnProbation() {
    return spoken_for_ms - life_since_ms < PROBATION_MS;
  }

  private void compareWith(layer_digest_t digest, long now_ms) {
    this.digest = digest;
    at_digest.clear();
    in_sync = false;
    lookForMatch(now_ms);
    if (this.digest == null) return;  // begun anew, with the next one
    if (!matches() && wanted.isEmpty()) beginCheck(now_ms);
  }

  private void beginLife(layer_epoch_t life, long now_ms) {
    life_since_ms = now_ms;
    beginAnew(life);
  }

  private void beginAnew(layer_epoch_t life) {
    if (previous == null && !tiles.isEmpty()) {
      previous = tiles;
      previous_life = this.life;
      tiles = new HashMap<>();
    }
    beginTiles(life);
  }

  // All are gone before this life was whole: what is shown is what there is.
  private void goBackALife() {
    beginTiles(previous_life);
    tiles = previous;
    previous = null;
    tiles.forEach((key, tile) -> addHash(key, tile.checksum));
  }

  private void beginTiles(layer_epoch_t life) {
    tiles.clear();
    hashes.clear();
    hash = 0;
    at_digest.clear();
    wanted.clear();
    digest = null;
    owners_digest = null;
    stand_in_digest = null;
    check = null;
    in_sync = false;
    this.life = life;
  }

  private boolean isOfThisLife(layer_epoch_t layer) {
    return life != null && compareLives(layer, life) == 0 && layer.detail_level == 0;
  }

  private static int compareLives(layer_epoch_t a, layer_epoch_t b) {
    int order = Long.compareUnsigned(a.incarnation, b.incarnation);
    return order != 0 ? order : Long.compareUnsigned(a.nonce, b.nonce);
  }

  // Of one state the time stamps tell; the owner's clock may be set back, by more than a message is
  // late.
  private static boolean wasOvertaken(layer_digest_t digest, layer_digest_t last) {
    if (digest.state != last.state) return digest.state < last.state;
    return isNoLater(digest, last);
  }

  private static boolean isNoLater(layer_digest_t digest, layer_digest_t last) {
    return digest.utime <= last.utime && digest.utime > last.utime - MAX_LATE_US;
  }

  private boolean matches() {
    return digest.hash == hash && digest.num_tiles == tiles.size();
  }

  private void beginCheck(long now_ms) {
    check = digest;
    int root_level = Math.max(1, Math.min(digest.root_level, Node.MAX_LEVEL));
    for (int y = -1; y <= 0; ++y) {
      for (int x = -1; x <= 0; ++x) want(new Node(root_level, x, y), 0, now_ms);
    }
  }

  private void lookForMatch(long now_ms) {
    if (!matches() && (check == null || !wanted.isEmpty())) return;
    if (previous != null && isOnProbation()) return;
    // Nothing came between two checks, and the owner has something else: what differs is not its.
    boolean is_foreign = !matches() && check == owners_digest && hash == hash_of_last_check;
    hash_of_last_check = hash;
    if (is_foreign) {
      beginAnew(life);
      return;
    }
    check = null;
    wanted.clear();
    in_sync = true;
    match_ms = now_ms;
    if (previous != null) forgetPrevious();
  }

  private void forgetPrevious() {
    changed.addAll(previous.keySet());
    changed.addAll(tiles.keySet());
    previous = null;
  }

  private void giveUpCheck() {
    check = null;
    in_sync = false;
  }

  private void apply(tile_update_t update) {
    Node key = new Node(0, update.tx, update.ty);
    Tile known = tiles.get(key);
    if (!key.isValid() || (known == null && is_full.getAsBoolean())) return;
    if (known != null && Long.compareUnsigned(known.revision, update.revision) >= 0) return;
    if (Long.compareUnsigned(update.revision, digest.revision + MAX_AHEAD) > 0) return;
    short[] points = TileCode.decode(update.content);
    if (update.base_checksum != 0) {
      Tile base = base(key, known, update.base_checksum);
      if (base == null) return;
      points = TileCode.sum(base.points, points);
    }
    if (TileCode.checksum(key, points) != update.checksum) return;
    for (short point : points) {
      if (point < digest.min_control_point || point > digest.max_control_point) return;
    }
    keep(key, known, new Tile(points, update.revision, update.checksum));
  }

  private Tile base(Node key, Tile known, long checksum) {
    if (known != null && known.checksum == checksum) return known;
    Tile old = at_digest.get(key);
    return old != null && old.checksum == checksum ? old : null;
  }

  private void keep(Node key, Tile known, Tile tile) {
    if (!at_digest.containsKey(key)) at_digest.put(key, known);
    tiles.put(key, tile);
    addHash(key, tile.checksum - (known == null ? 0 : known.checksum));
    Wanted asked = wanted.get(key);
    if (asked != null && Long.compareUnsigned(asked.revision, tile.revision) <= 0) {
      wanted.remove(key);
    }
    if (previous == null) changed.add(key);
  }

  private void addHash(Node tile, long difference) {
    hash += difference;
    for (Node node = tile; ; node = node.parent()) {
      hashes.merge(node, difference, Long::sum);
      if (node.level() == Node.MAX_LEVEL) break;
    }
  }

  private void takeNode(node_listing_t listing, long now_ms) {
    Node node = new Node(listing.level, listing.x, listing.y);
    if (listing.level < 1 || !node.isValid()) return;
    // Others ask, too; to take up what they are told would leave no moment without wants.
    if (wanted.remove(node) == null) return;
    for (int k = 0; k < listing.num_children; ++k) {
      takeChild(node.child(listing.children[k] & 63), listing.hashes[k], listing.revisions[k],
                now_ms);
    }
  }

  private void takeChild(Node child, long hash, long revision, long now_ms) {
    if (!child.isValid()) return;
    if (hashes.getOrDefault(child, 0L) == hash) {
      wanted.remove(child);
      return;
    }
    if (child.level() > 0) {
      want(child, 0, now_ms);
      return;
    }
    Tile known = tiles.get(child);
    if (known != null && Long.compareUnsigned(known.revision, revision) >= 0) return;
    if (known == null && is_full.getAsBoolean()) {
      giveUpCheck();
    } else {
      want(child, revision, now_ms);
    }
  }

  private void want(Node node, long revision, long now_ms) {
    if (wanted.size() >= MAX_WANTED) {
      giveUpCheck();
      return;
    }
    Wanted known = wanted.computeIfAbsent(node, n -> new Wanted());
    if (known.due_ms == 0) known.due_ms = now_ms + random.nextInt(MAX_BACK_OFF_MS);
    if (Long.compareUnsigned(known.revision, revision) < 0) known.revision = revision;
  }

  private layer_pull_t pullOf(List<Node> nodes) {
    layer_pull_t pull = new layer_pull_t();
    pull.layer = digest.layer;  // `life` may be from one of a coarser level
    pull.num_nodes = nodes.size();
    pull.levels = nodes.stream().mapToInt(Node::level).toArray();
    pull.xs = nodes.stream().mapToInt(Node::x).toArray();
    pull.ys = nodes.stream().mapToInt(Node::y).toArray();
    return pull;
  }
}
