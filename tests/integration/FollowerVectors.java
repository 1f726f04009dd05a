package splinemap.spy;

import java.util.Arrays;
import java.util.HexFormat;
import java.util.List;
import java.util.stream.IntStream;
import splinemap.layer_digest_t;
import splinemap.layer_pull_t;
import splinemap.layer_updates_t;

/**
 * Checks the follower in lcm-spy against messages and checksums that the C++ code made. The layer
 * has tile (-3, 9), whose left half is -40 and whose right half is 230.
 */
final class FollowerVectors {
  private static final String LAYER = """
      00000006726f626f74001122334455667788000000000000000399aabbccddeeff000000""";
  private static final byte[] UPDATE = bytes("b53cd98dd48a039599aabbccddeeff00" + LAYER + """
      00000001fffffffd0000000900000000000000010000000000000000fa6a73deec14c5020000003a28b52ffd
      60000785010040d8ffe600e600e6007da8e0c7f08535111086ff3f3f06fbffdfffffeffffff7fffffbfffffd
      ff7f83ff11ac4a553205""");
  private static final byte[] DIFFERENCE = bytes("b53cd98dd48a039599aabbccddeeff00" + LAYER + """
      00000001fffffffd000000090000000000000002fa6a73deec14c5024e3f076d894a4a800000001328b52ffd
      6000074d0000102d000100fbff000b""");
  private static final byte[] DIGEST = bytes("1f29e6de6fcaabb999aabbccddeeff00" + LAYER + """
      0000000200000000000f42403fa999999999999afffff60000000a0000000000000000010000000000000001
      0000000000000001fa6a73deec14c502000000020000000000000000""");
  private static final byte[] LISTING = bytes("51456dbc02f83e7499aabbccddeeff00" + LAYER + """
      00000000000000010000000100000002ffffffff00000000000000010ffa6a73deec14c50200000000000000
      00""");
  private static final byte[] SETTINGS = bytes("""
      16d7db74eb3b3426010203040506070811121314151617180000000100000006726f626f7400112233445566
      7788000100000020ffffffc000000000000000070000000000000009000000000000000201""");
  private static final long OWNER = 0x99aabbccddeeff00L;
  private static final long SELF = 7;
  private static final Node TILE = new Node(0, -3, 9);
  private static final Node SHIFTED_TILE = new Node(0, -2, 7);  // by 32 and -64 knots

  public static void main(String[] arguments) {
    checkChecksums();
    checkUpdates();
    checkPulls();
    checkSpeakers();
    checkSettings();
  }

  private static void checkChecksums() {
    check(TileCodec.checksum(TILE, tile(-40)) == 0xfa6a73deec14c502L, "checksum of a tile");
    check(TileCodec.checksum(TILE, tile(5)) == 0x4e3f076d894a4a80L, "checksum of another tile");
  }

  private static void checkUpdates() {
    MapFollower map = new MapFollower(SELF);
    map.handleUpdates(Messages.updates(UPDATE));
    check(!map.refresh(0), "a session starts with a digest");
    map.handleDigest(Messages.digest(DIGEST), 0);
    check(map.status(0).contains("behind"), "without the tile");
    map.handleUpdates(Messages.updates(UPDATE));
    check(map.refresh(0) && Arrays.equals(map.points(TILE), tile(-40)), "update");
    check(map.tick(100).isEmpty() && map.status(100).contains("caught up"), "hash");
    map.handleUpdates(Messages.updates(DIFFERENCE));
    check(map.refresh(0) && Arrays.equals(map.points(TILE), tile(5)), "difference");
  }

  private static void checkPulls() {
    MapFollower map = new MapFollower(SELF);
    map.handleDigest(Messages.digest(DIGEST), 0);
    List<layer_pull_t> pulls = map.tick(100);
    check(pulls.size() == 1 && pulls.get(0).speaker == SELF, "speaker of a pull");
    check(pulls.get(0).layer.session_nonce == OWNER, "session of a pull");
    check(Arrays.equals(pulls.get(0).levels, new int[] {2, 2, 2, 2})
        && Arrays.equals(pulls.get(0).xs, new int[] {-1, 0, -1, 0})
        && Arrays.equals(pulls.get(0).ys, new int[] {-1, -1, 0, 0}), "nodes at the root level");
    map.handleListing(Messages.listing(LISTING), 100);
    pulls = map.tick(250);
    check(pulls.size() == 1 && pulls.get(0).num_nodes == 1 && pulls.get(0).levels[0] == 1
        && pulls.get(0).xs[0] == -1 && pulls.get(0).ys[0] == 1, "the node that differs");
  }

  private static void checkSpeakers() {
    MapFollower self = new MapFollower(OWNER);
    self.handleDigest(Messages.digest(DIGEST), 0);
    check(self.status(0).startsWith("No daemon"), "own messages are ignored");

    MapFollower map = new MapFollower(SELF);
    map.handleDigest(Messages.digest(DIGEST), 0);
    map.handleUpdates(Messages.updates(UPDATE));
    map.tick(100);
    layer_digest_t of_proxy = Messages.digest(DIGEST);
    of_proxy.speaker = 8;
    of_proxy.hash = 1;
    map.handleDigest(of_proxy, 3000);
    check(map.tick(3200).isEmpty(), "a proxy is ignored while the owner speaks");
    map.handleDigest(of_proxy, 3300);
    check(!map.tick(3400).isEmpty(), "a proxy speaks for a silent owner");
    layer_updates_t own = Messages.updates(DIFFERENCE);
    own.speaker = SELF;
    map.handleUpdates(own);
    map.refresh(3400);
    check(Arrays.equals(map.points(TILE), tile(-40)), "own updates are ignored");
  }

  private static void checkSettings() {
    MapFollower map = new MapFollower(SELF);
    map.handleDigest(Messages.digest(DIGEST), 0);
    map.handleUpdates(Messages.updates(UPDATE));
    map.handleSettings(Messages.settings(SETTINGS));
    check(map.refresh(0) && map.points(TILE) == null
        && Arrays.equals(map.points(SHIFTED_TILE), tile(-40)), "shift");
    LayerSettings told = LayerSettings.of(Messages.settings(SETTINGS).layers[0]);
    check(told.equals(new LayerSettings(false, true, 32, -64, 7, 9, 2)), "fields of settings");
    LayerSettings later = new LayerSettings(true, false, 0, 0, 8, 1, 0);
    LayerSettings merged = new LayerSettings(true, false, 0, 0, 8, 1, 2);
    check(told.merge(later).equals(merged) && later.merge(told).equals(merged), "merged settings");
  }

  private static short[] tile(int first) {
    short[] points = new short[TileCodec.SIDE * TileCodec.SIDE];
    IntStream.range(0, points.length)
        .forEach(k -> points[k] = (short) (k % TileCodec.SIDE < TileCodec.SIDE / 2 ? -40 : 230));
    points[0] = (short) first;
    return points;
  }

  private static byte[] bytes(String hex) {
    return HexFormat.of().parseHex(hex.replace("\n", ""));
  }

  private static void check(boolean is_good, String what) {
    if (!is_good) throw new AssertionError(what);
  }

  private FollowerVectors() {}
}
