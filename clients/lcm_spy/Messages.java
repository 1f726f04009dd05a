package splinemap.spy;

import java.nio.ByteBuffer;
import java.nio.charset.StandardCharsets;
import splinemap.layer_digest_t;
import splinemap.layer_epoch_t;
import splinemap.layer_listing_t;
import splinemap.layer_updates_t;
import splinemap.node_listing_t;
import splinemap.tile_update_t;

/**
 * Decodes what any process may have put on the bus, which the generated decoders do not stand: they
 * allocate what a message claims. Here a RuntimeException is all that a bad message causes.
 */
final class Messages {
  private static final int MAX_NAME_BYTES = 256;

  static layer_digest_t digest(byte[] message) {
    ByteBuffer in = open(message, layer_digest_t.LCM_FINGERPRINT);
    layer_digest_t digest = new layer_digest_t();
    digest.layer = epoch(in);
    digest.protocol_version = in.getInt();
    digest.utime = in.getLong();
    digest.knot_interval_m = in.getDouble();
    digest.min_control_point = in.getInt();
    digest.max_control_point = in.getInt();
    digest.state = in.getLong();
    digest.revision = in.getLong();
    digest.num_tiles = in.getLong();
    digest.hash = in.getLong();
    digest.root_level = in.getInt();
    digest.lag_s = in.getDouble();
    check(!in.hasRemaining());
    check(digest.knot_interval_m > 0 && Double.isFinite(digest.knot_interval_m));
    check(digest.min_control_point >= Short.MIN_VALUE && digest.min_control_point < 0);
    check(digest.max_control_point <= Short.MAX_VALUE && digest.max_control_point > 0);
    return digest;
  }

  static layer_updates_t updates(byte[] message) {
    ByteBuffer in = open(message, layer_updates_t.LCM_FINGERPRINT);
    layer_updates_t updates = new layer_updates_t();
    updates.layer = epoch(in);
    updates.num_tiles = count(in, 4 + 4 + 8 + 8 + 8 + 4);
    updates.tiles = new tile_update_t[updates.num_tiles];
    for (int k = 0; k < updates.num_tiles; ++k) updates.tiles[k] = tile(in);
    check(!in.hasRemaining());
    return updates;
  }

  static layer_listing_t listing(byte[] message) {
    ByteBuffer in = open(message, layer_listing_t.LCM_FINGERPRINT);
    layer_listing_t listing = new layer_listing_t();
    listing.layer = epoch(in);
    listing.state = in.getLong();
    listing.num_nodes = count(in, 4 * 4);
    listing.nodes = new node_listing_t[listing.num_nodes];
    for (int k = 0; k < listing.num_nodes; ++k) listing.nodes[k] = node(in);
    check(!in.hasRemaining());
    return listing;
  }

  private static layer_epoch_t epoch(ByteBuffer in) {
    layer_epoch_t epoch = new layer_epoch_t();
    byte[] name = new byte[count(in, 1)];
    in.get(name);
    check(name.length > 1 && name.length <= MAX_NAME_BYTES + 1 && name[name.length - 1] == 0);
    // LCM's own coding of strings in Java, in which a pull gives the name back as it came.
    epoch.name = new String(name, 0, name.length - 1, StandardCharsets.ISO_8859_1);
    check(epoch.name.indexOf('\0') < 0);
    epoch.origin = in.getLong();
    epoch.incarnation = in.getLong();
    epoch.nonce = in.getLong();
    epoch.detail_level = in.get();
    epoch.band = in.get();
    return epoch;
  }

  private static tile_update_t tile(ByteBuffer in) {
    tile_update_t tile = new tile_update_t();
    tile.tx = in.getInt();
    tile.ty = in.getInt();
    tile.revision = in.getLong();
    tile.base_checksum = in.getLong();
    tile.checksum = in.getLong();
    tile.num_bytes = count(in, 1);
    tile.content = new byte[tile.num_bytes];
    in.get(tile.content);
    return tile;
  }

  private static node_listing_t node(ByteBuffer in) {
    node_listing_t node = new node_listing_t();
    node.level = in.getInt();
    node.x = in.getInt();
    node.y = in.getInt();
    node.num_children = count(in, 1 + 8 + 8);
    node.children = new byte[node.num_children];
    node.hashes = new long[node.num_children];
    node.revisions = new long[node.num_children];
    in.get(node.children);
    for (int k = 0; k < node.num_children; ++k) node.hashes[k] = in.getLong();
    for (int k = 0; k < node.num_children; ++k) node.revisions[k] = in.getLong();
    return node;
  }

  private static ByteBuffer open(byte[] message, long fingerprint) {
    ByteBuffer in = ByteBuffer.wrap(message);  // big-endian, as LCM
    check(in.getLong() == fingerprint);
    return in;
  }

  /** Of elements that have at least so many bytes each, which are there. */
  private static int count(ByteBuffer in, int bytes_each) {
    int count = in.getInt();
    check(count >= 0 && (long) count * bytes_each <= in.remaining());
    return count;
  }

  private static void check(boolean is_good) {
    if (!is_good) throw new IllegalArgumentException("malformed message");
  }

  private Messages() {}
}
