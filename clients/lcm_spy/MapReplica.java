package splinemap.spy;

import java.io.IOException;
import java.util.Random;
import java.util.Timer;
import java.util.TimerTask;
import java.util.regex.Pattern;
import lcm.lcm.LCM;
import lcm.lcm.LCMDataInputStream;
import splinemap.layer_pull_t;
import splinemap.layer_settings_t;
import splinemap.settings_t;

/** A live copy of the map on a bus, kept by threads of its own. */
final class MapReplica implements AutoCloseable {
  private static final int TICK_MS = 100;

  private final LCM lcm;
  private final String prefix;  // of the channels: "SPLINEMAP"
  private final long speaker = new Random().nextLong();
  private final MapFollower map = new MapFollower(speaker);
  private final Timer timer = new Timer("splinemap pulls", true);

  /** Follows the bus that LCM_DEFAULT_URL names: lcm-spy does not lend its own connection. */
  MapReplica(String prefix) throws IOException {
    this.prefix = prefix;
    lcm = new LCM();
    subscribe("_DIGESTS", message -> map.handleDigest(Messages.digest(message), nowMs()));
    subscribe("_SETTINGS", message -> map.handleSettings(Messages.settings(message)));
    subscribe("_UPDATES", message -> map.handleUpdates(Messages.updates(message)));
    subscribe("_LISTINGS", message -> map.handleListing(Messages.listing(message), nowMs()));
    timer.schedule(new TimerTask() {
      @Override
      public void run() {
        tick();
      }
    }, TICK_MS, TICK_MS);
  }

  static long nowMs() {
    return System.nanoTime() / 1_000_000;
  }

  MapFollower map() {
    return map;
  }

  @Override
  public void close() {
    timer.cancel();
    lcm.close();
  }

  private interface Handler {
    void handle(byte[] message);
  }

  private void subscribe(String suffix, Handler handler) {
    lcm.subscribe(Pattern.quote(prefix + suffix), (bus, channel, in) -> {
      try {
        handler.handle(bytes(in));
      } catch (IOException | RuntimeException e) {
        // Any process may publish malformed messages. The follower pulls what is lost by one.
      }
    });
  }

  private static byte[] bytes(LCMDataInputStream in) throws IOException {
    byte[] bytes = new byte[in.available()];
    in.readFully(bytes);
    return bytes;
  }

  private void tick() {
    try {
      for (layer_pull_t pull : map.tick(nowMs())) lcm.publish(prefix + "_PULLS", pull);
      if (map.asksForSettings(nowMs())) lcm.publish(prefix + "_SETTINGS", noSettings());
    } catch (IllegalStateException e) {
      timer.cancel();  // the replica was closed meanwhile
    }
  }

  private settings_t noSettings() {
    settings_t message = new settings_t();
    message.speaker = speaker;
    message.layers = new layer_settings_t[0];
    return message;
  }
}
