package splinemap.spy;

import java.nio.ByteBuffer;
import java.nio.charset.StandardCharsets;
import splinemap.layer_digest_t;
import splinemap.layer_listing_t;
import splinemap.layer_ref_t;
import splinemap.layer_settings_t;
import splinemap.layer_updates_t;
import splinemap.node_listing_t;
import splinemap.settings_t;
import splinemap.tile_update_t;

/**
 * Decodes what any process may have put on the bus. A malformed message causes a RuntimeException,
 * while the generated decoders allocate as much as it claims.
 */
final class Messages {
  private static final int MAX_NAME_BYTES = 256;

  static layer_digest_t digest(byte[] message) {
    ByteBuffer in = open(message, layer_digest_t.LCM_FINGERPRINT);
    layer_digest_t digest = new layer_digest_t();
    digest.speaker = in.getLong();
    digest.layer = layer(in);
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

  static settings_t settings(byte[] message) {
    ByteBuffer in = open(message, settings_t.LCM_FINGERPRINT);
    settings_t settings = new settings_t();
    settings.speaker = in.getLong();
    settings.hash = in.getLong();
    settings.num_layers = count(in, 4 + 8 + 2 + 2 * 4 + 3 * 8 + 1);
    settings.layers = new layer_settings_t[settings.num_layers];
    for (int k = 0; k < settings.num_layers; ++k) settings.layers[k] = layerSettings(in);
    check(!in.hasRemaining());
    return settings;
  }

  static layer_updates_t updates(byte[] message) {
    ByteBuffer in = open(message, layer_updates_t.LCM_FINGERPRINT);
    layer_updates_t updates = new layer_updates_t();
    updates.speaker = in.getLong();
    updates.layer = layer(in);
    updates.num_tiles = count(in, 4 + 4 + 8 + 8 + 8 + 4);
    updates.tiles = new tile_update_t[updates.num_tiles];
    for (int k = 0; k < updates.num_tiles; ++k) updates.tiles[k] = tile(in);
    check(!in.hasRemaining());
    return updates;
  }

  static layer_listing_t listing(byte[] message) {
    ByteBuffer in = open(message, layer_listing_t.LCM_FINGERPRINT);
    layer_listing_t listing = new layer_listing_t();
    listing.speaker = in.getLong();
    listing.layer = layer(in);
    listing.state = in.getLong();
    listing.num_nodes = count(in, 4 * 4);
    listing.nodes = new node_listing_t[listing.num_nodes];
    for (int k = 0; k < listing.num_nodes; ++k) listing.nodes[k] = node(in);
    check(!in.hasRemaining());
    return listing;
  }

  private static layer_settings_t layerSettings(ByteBuffer in) {
    layer_settings_t settings = new layer_settings_t();
    settings.name = name(in);
    settings.origin = in.getLong();
    settings.muted = in.get() != 0;
    settings.low_weight = in.get() != 0;
    settings.shift_i = in.getInt();
    settings.shift_j = in.getInt();
    settings.counter = in.getLong();
    settings.writer = in.getLong();
    settings.removed_up_to = in.getLong();
    settings.has_layer = in.get() != 0;
    return settings;
  }

  private static String name(ByteBuffer in) {
    byte[] bytes = new byte[count(in, 1)];
    in.get(bytes);
    check(bytes.length > 1 && bytes.length <= MAX_NAME_BYTES + 1 && bytes[bytes.length - 1] == 0);
    // LCM encodes strings so in Java, so a pull has the same bytes of the name.
    String name = new String(bytes, 0, bytes.length - 1, StandardCharsets.ISO_8859_1);
    check(name.indexOf('\0') < 0);
    return name;
  }

  private static layer_ref_t layer(ByteBuffer in) {
    layer_ref_t layer = new layer_ref_t();
    layer.name = name(in);
    layer.origin = in.getLong();
    layer.session_number = in.getLong();
    layer.session_nonce = in.getLong();
    layer.level = in.get();
    layer.statistic = in.get();
    return layer;
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

  // A number of elements, checked against the bytes that are left.
  private static int count(ByteBuffer in, int min_bytes_each) {
    int count = in.getInt();
    check(count >= 0 && (long) count * min_bytes_each <= in.remaining());
    return count;
  }

  private static void check(boolean is_good) {
    if (!is_good) throw new IllegalArgumentException("malformed message");
  }

  private Messages() {}
}
