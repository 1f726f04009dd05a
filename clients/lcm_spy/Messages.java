package splinemap.spy;

import java.nio.ByteBuffer;
import java.nio.charset.StandardCharsets;
import splinemap.control_records_t;
import splinemap.layer_control_t;
import splinemap.layer_digest_t;
import splinemap.layer_epoch_t;
import splinemap.layer_listing_t;
import splinemap.layer_updates_t;
import splinemap.node_listing_t;
import splinemap.stand_in_digest_t;
import splinemap.tile_update_t;

/**
 * Decodes what any process may have put on the bus, which the generated decoders do not stand: they
 * allocate what a message claims. Here a RuntimeException is all that a bad message causes.
 */
final class Messages {
  private static final int MAX_NAME_BYTES = 256;

  static layer_digest_t digest(byte[] message) {
    return digest(open(message, layer_digest_t.LCM_FINGERPRINT));
  }

  static stand_in_digest_t standInDigest(byte[] message) {
    ByteBuffer in = open(message, stand_in_digest_t.LCM_FINGERPRINT);
    stand_in_digest_t stand_in = new stand_in_digest_t();
    stand_in.daemon_nonce = in.getLong();
    stand_in.digest = digest(in);
    return stand_in;
  }

  static control_records_t controls(byte[] message) {
    ByteBuffer in = open(message, control_records_t.LCM_FINGERPRINT);
    control_records_t controls = new control_records_t();
    controls.sender = in.getLong();
    controls.hash = in.getLong();
    controls.num_records = count(in, 4 + 8 + 2 + 2 * 4 + 3 * 8 + 3 * 8 + 1);
    controls.records = new layer_control_t[controls.num_records];
    for (int k = 0; k < controls.num_records; ++k) controls.records[k] = control(in);
    check(!in.hasRemaining());
    return controls;
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

  /** At the end of a message. */
  private static layer_digest_t digest(ByteBuffer in) {
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

  private static layer_control_t control(ByteBuffer in) {
    layer_control_t control = new layer_control_t();
    control.name = name(in);
    control.origin = in.getLong();
    control.muted = in.get() != 0;
    control.yields = in.get() != 0;
    control.shift_i = in.getInt();
    control.shift_j = in.getInt();
    control.x_m = in.getDouble();
    control.y_m = in.getDouble();
    control.yaw_rad = in.getDouble();
    control.counter = in.getLong();
    control.writer = in.getLong();
    control.removed_up_to = in.getLong();
    control.has_layer = in.get() != 0;
    return control;
  }

  private static String name(ByteBuffer in) {
    byte[] bytes = new byte[count(in, 1)];
    in.get(bytes);
    check(bytes.length > 1 && bytes.length <= MAX_NAME_BYTES + 1 && bytes[bytes.length - 1] == 0);
    // LCM's own coding of strings in Java, in which a pull gives the name back as it came.
    String name = new String(bytes, 0, bytes.length - 1, StandardCharsets.ISO_8859_1);
    check(name.indexOf('\0') < 0);
    return name;
  }

  private static layer_epoch_t epoch(ByteBuffer in) {
    layer_epoch_t epoch = new layer_epoch_t();
    epoch.name = name(in);
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
