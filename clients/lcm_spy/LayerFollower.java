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
import splinemap.layer_listing_t;
import splinemap.layer_pull_t;
import splinemap.layer_ref_t;
import splinemap.layer_updates_t;
import splinemap.node_listing_t;
import splinemap.tile_update_t;

/**
 * The follower's side of the protocol for one layer as it was mapped: a copy of what its owner has
 * published, made of whatever messages arrive. lcmtypes/ describes the rules. It leaves out what a
 * client may leave out: others' pulls, tiles of the session before, and coarser levels.
 */
final class LayerFollower {
  private static final int MAX_BACK_OFF_MS = 100;  // most of what is on its way has come then
  private static final int RETRY_MS = 300;
  private static final int MAX_ASKS = 32;
  private static final int MAX_ASKED_AT_ONCE = 256;
  private static final int NODES_PER_PULL = 100;
  private static final int MAX_PENDING = 8192;
  private static final int MAX_LATE_US = 5_000_000;
  private static final long OWNER_TIMEOUT_MS = 3000;  // proxies speak for an owner that is silent
  // A session that nobody speaks for any more is given up if the copy never caught up with it.
  private static final long GIVE_UP_SESSION_MS = 10_000;
  // One digest may be a mistake or a lie. So a session is established after it was spoken for that
  // long, and until then it is given up sooner.
  private static final long PROBATION_MS = 2000;
  private static final long GIVE_UP_ON_PROBATION_MS = 3500;
  private static final long MAX_AHEAD = 1 << 20;  // commits that an owner pushes between digests

  private static final long NEVER_MS = Long.MIN_VALUE / 2;

  private record Tile(short[] points, long revision, long checksum) {}

  private static final class PendingPull {
    long due_ms;
    long revision;  // of a tile: that one or a newer
    int times_asked;
  }

  private final BooleanSupplier is_full;  // whether no more tiles are kept
  private final Random random = new Random();
  private layer_ref_t session;
  private long session_since_ms;
  private layer_digest_t digest;         // the last of this session
  private layer_digest_t owners_digest;  // the last of the owner
  private layer_digest_t proxy_digest;   // the last of a proxy
  private Map<Node, Tile> tiles = new HashMap<>();
  private final Map<Node, Long> hashes = new HashMap<>();  // sums of the tiles' checksums
  private long hash;                                       // of all tiles
  // Tiles that changed since the last digest, as they were then; null where there was none.
  private final Map<Node, Tile> at_digest = new HashMap<>();
  private Map<Node, Tile> previous;  // of the session before: shown until this one has caught up
  private layer_ref_t previous_session;
  private final Map<Node, PendingPull> pending = new LinkedHashMap<>();
  private layer_digest_t check;  // its hashes are compared until no pull is pending
  private long hash_of_last_check;
  private boolean caught_up;
  private Set<Node> changed = new HashSet<>();
  private long last_heard_ms = NEVER_MS;  // the owner
  private long last_spoken_for_ms = NEVER_MS;
  private long last_match_ms = NEVER_MS;

  LayerFollower(BooleanSupplier is_full) {
    this.is_full = is_full;
  }

  /** Whether all that the last digest told of is there. */
  boolean caughtUp() {
    return caught_up;
  }

  /** When the copy last caught up with a digest. */
  long lastMatchMs() {
    return last_match_ms;
  }

  /** When the owner or a proxy for it was last heard. */
  long lastSpokenForMs() {
    return last_spoken_for_ms;
  }

  int numTilesKept() {
    return tiles.size() + (previous == null ? 0 : previous.size());
  }

  /** The control points to show, row-major; null where there are none. */
  short[] points(Node tile) {
    Tile found = shown().get(tile);
    return found == null ? null : found.points;
  }

  /** The tiles whose points have changed since the last call. */
  Set<Node> takeChanged() {
    Set<Node> taken = changed;
    changed = new HashSet<>();
    return taken;
  }

  Set<Node> tiles() {
    return shown().keySet();
  }

  void handleDigest(layer_digest_t digest, long now_ms) {
    if (digest.speaker == digest.layer.session_nonce) {
      handleOwnersDigest(digest, now_ms);
    } else {
      handleProxyDigest(digest, now_ms);
    }
  }

  /** True where no tiles are left. */
  boolean isRemovedBy(LayerSettings settings) {
    if (previous != null && settings.isRemoved(previous_session)) forgetPreviousSession();
    return settings.isRemoved(session);
  }

  void handleUpdates(layer_updates_t updates) {
    if (!isOfThisSession(updates.layer) || digest == null) return;
    for (tile_update_t update : updates.tiles) apply(update);
  }

  void handleListing(layer_listing_t listing, long now_ms) {
    if (!isOfThisSession(listing.layer) || check == null || listing.state < check.state) return;
    for (node_listing_t node : listing.nodes) handleNode(node, now_ms);
  }

  /** The pulls to publish now, without a speaker. Call it some times a second. */
  List<layer_pull_t> tick(long now_ms) {
    long give_up_ms = isOnProbation() ? GIVE_UP_ON_PROBATION_MS : GIVE_UP_SESSION_MS;
    if (previous != null && now_ms - last_spoken_for_ms > give_up_ms) restorePreviousSession();
    if (digest != null && !caught_up) updateSync(now_ms);
    if (pending.values().removeIf(pull -> pull.times_asked >= MAX_ASKS && pull.due_ms <= now_ms)) {
      giveUpCheck();  // a later digest shows again what is missing
    }
    List<Node> asked = new ArrayList<>();
    long room = MAX_ASKED_AT_ONCE
        - pending.values().stream().filter(p -> p.times_asked > 0 && p.due_ms > now_ms).count();
    for (Map.Entry<Node, PendingPull> entry : pending.entrySet()) {
      if (asked.size() >= room) break;
      PendingPull pull = entry.getValue();
      if (pull.due_ms > now_ms) continue;
      asked.add(entry.getKey());
      pull.due_ms = now_ms + RETRY_MS + random.nextInt(RETRY_MS);
      ++pull.times_asked;
    }
    List<layer_pull_t> pulls = new ArrayList<>();
    for (int k = 0; k < asked.size(); k += NODES_PER_PULL) {
      pulls.add(pullOf(asked.subList(k, Math.min(k + NODES_PER_PULL, asked.size()))));
    }
    return pulls;
  }

  private void handleOwnersDigest(layer_digest_t digest, long now_ms) {
    if (!reachesSession(digest.layer, now_ms)) return;
    last_heard_ms = now_ms;
    last_spoken_for_ms = now_ms;
    if (digest.layer.level != 0) return;
    if (owners_digest != null && wasOvertaken(digest, owners_digest)) return;
    owners_digest = digest;
    compareWith(digest, now_ms);
  }

  // Proxies are ignored as long as the owner itself speaks.
  private void handleProxyDigest(layer_digest_t digest, long now_ms) {
    boolean is_of_this_session = session != null && compareSessions(digest.layer, session) == 0;
    if (is_of_this_session && now_ms - last_heard_ms <= OWNER_TIMEOUT_MS) return;
    if (!reachesSession(digest.layer, now_ms)) return;
    last_spoken_for_ms = now_ms;
    if (digest.layer.level != 0) return;
    // The states of two proxies cannot be compared.
    if (proxy_digest != null && proxy_digest.speaker == digest.speaker
        && isNoLater(digest, proxy_digest)) {
      return;
    }
    proxy_digest = digest;
    compareWith(digest, now_ms);
  }

  private Map<Node, Tile> shown() {
    return previous != null ? previous : tiles;
  }

  // Starts the session if it is a greater one; false for a lesser one.
  private boolean reachesSession(layer_ref_t layer, long now_ms) {
    int order = session == null ? 1 : compareSessions(layer, session);
    if (order > 0) startSession(layer, now_ms);
    return order >= 0;
  }

  private boolean isOnProbation() {
    return last_spoken_for_ms - session_since_ms < PROBATION_MS;
  }

  private void compareWith(layer_digest_t digest, long now_ms) {
    this.digest = digest;
    at_digest.clear();
    caught_up = false;
    updateSync(now_ms);
    if (this.digest == null) return;  // the copy was dropped, and waits for the next digest
    if (!matches() && pending.isEmpty()) beginCheck(now_ms);
  }

  private void startSession(layer_ref_t layer, long now_ms) {
    session_since_ms = now_ms;
    beginAnew(layer);
  }

  private void beginAnew(layer_ref_t layer) {
    if (previous == null && !tiles.isEmpty()) {
      previous = tiles;
      previous_session = session;
      tiles = new HashMap<>();
    }
    beginTiles(layer);
  }

  // All have fallen silent before the copy caught up, so it stays what is shown.
  private void restorePreviousSession() {
    beginTiles(previous_session);
    tiles = previous;
    previous = null;
    tiles.forEach((key, tile) -> addHash(key, tile.checksum));
  }

  private void beginTiles(layer_ref_t layer) {
    tiles.clear();
    hashes.clear();
    hash = 0;
    at_digest.clear();
    pending.clear();
    digest = null;
    owners_digest = null;
    proxy_digest = null;
    check = null;
    caught_up = false;
    session = layer;
  }

  private boolean isOfThisSession(layer_ref_t layer) {
    return session != null && compareSessions(layer, session) == 0 && layer.level == 0;
  }

  private static int compareSessions(layer_ref_t a, layer_ref_t b) {
    int order = Long.compareUnsigned(a.session_number, b.session_number);
    return order != 0 ? order : Long.compareUnsigned(a.session_nonce, b.session_nonce);
  }

  // Whether a digest is older than the last of the same speaker, or equal to it.
  private static boolean wasOvertaken(layer_digest_t digest, layer_digest_t last) {
    if (digest.state != last.state) return digest.state < last.state;
    return isNoLater(digest, last);
  }

  // The speaker's clock may be set back, but by more than a message is late.
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

  private void updateSync(long now_ms) {
    if (!matches() && (check == null || !pending.isEmpty())) return;
    if (previous != null && isOnProbation()) return;
    // The owner does not have these tiles: the hashes differ, and nothing came between two checks.
    boolean is_disowned = !matches() && check == owners_digest && hash == hash_of_last_check;
    hash_of_last_check = hash;
    if (is_disowned) {
      beginAnew(session);
      return;
    }
    check = null;
    pending.clear();
    caught_up = true;
    last_match_ms = now_ms;
    if (previous != null) forgetPreviousSession();
  }

  private void forgetPreviousSession() {
    changed.addAll(previous.keySet());
    changed.addAll(tiles.keySet());
    previous = null;
  }

  private void giveUpCheck() {
    check = null;
    caught_up = false;
  }

  private void apply(tile_update_t update) {
    Node key = new Node(0, update.tx, update.ty);
    Tile known = tiles.get(key);
    if (!key.isValid() || (known == null && is_full.getAsBoolean())) return;
    if (known != null && Long.compareUnsigned(known.revision, update.revision) >= 0) return;
    if (Long.compareUnsigned(update.revision, digest.revision + MAX_AHEAD) > 0) return;
    short[] points = TileCodec.decode(update.content);
    if (update.base_checksum != 0) {
      Tile base = base(key, known, update.base_checksum);
      if (base == null) return;
      points = TileCodec.sum(base.points, points);
    }
    if (TileCodec.checksum(key, points) != update.checksum) return;
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
    PendingPull pull = pending.get(key);
    if (pull != null && Long.compareUnsigned(pull.revision, tile.revision) <= 0) {
      pending.remove(key);
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

  private void handleNode(node_listing_t listing, long now_ms) {
    Node node = new Node(listing.level, listing.x, listing.y);
    if (listing.level < 1 || !node.isValid()) return;
    // Others' answers are left out: with them there would be no moment without pending pulls.
    if (pending.remove(node) == null) return;
    for (int k = 0; k < listing.num_children; ++k) {
      handleChild(node.child(listing.children[k] & 63), listing.hashes[k], listing.revisions[k],
                  now_ms);
    }
  }

  private void handleChild(Node child, long hash, long revision, long now_ms) {
    if (!child.isValid()) return;
    if (hashes.getOrDefault(child, 0L) == hash) {
      pending.remove(child);
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
    if (pending.size() >= MAX_PENDING) {
      giveUpCheck();
      return;
    }
    PendingPull pull = pending.computeIfAbsent(node, n -> new PendingPull());
    if (pull.due_ms == 0) pull.due_ms = now_ms + random.nextInt(MAX_BACK_OFF_MS);
    if (Long.compareUnsigned(pull.revision, revision) < 0) pull.revision = revision;
  }

  private layer_pull_t pullOf(List<Node> nodes) {
    layer_pull_t pull = new layer_pull_t();
    pull.layer = digest.layer;  // `session` may be from a digest of a coarser level
    pull.num_nodes = nodes.size();
    pull.levels = nodes.stream().mapToInt(Node::level).toArray();
    pull.xs = nodes.stream().mapToInt(Node::x).toArray();
    pull.ys = nodes.stream().mapToInt(Node::y).toArray();
    return pull;
  }
}
