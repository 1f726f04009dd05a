package splinemap.spy;

import java.io.IOException;
import java.util.Random;
import java.util.Timer;
import java.util.TimerTask;
import java.util.regex.Pattern;
import lcm.lcm.LCM;
import lcm.lcm.LCMDataInputStream;
import splinemap.control_records_t;
import splinemap.layer_control_t;
import splinemap.layer_pull_t;

/** Keeps a MapCopy up to date from a bus, on threads of its own. */
final class MapFollower implements AutoCloseable {
  private static final int TICK_MS = 100;

  private final LCM lcm;
  private final String prefix;  // of the channels: "SPLINEMAP"
  private final MapCopy map = new MapCopy();
  private final long sender = new Random().nextLong();
  private final Timer timer = new Timer("splinemap pulls", true);

  /** On the bus that LCM_DEFAULT_URL names: lcm-spy does not lend its own. */
  MapFollower(String prefix) throws IOException {
    this.prefix = prefix;
    lcm = new LCM();
    subscribe("_DIGESTS", message -> map.takeDigest(Messages.digest(message), nowMs()));
    subscribe("_STAND_INS",
              message -> map.takeStandInDigest(Messages.standInDigest(message), nowMs()));
    subscribe("_CONTROL", message -> map.takeControls(Messages.controls(message)));
    subscribe("_UPDATES", message -> map.takeUpdates(Messages.updates(message)));
    subscribe("_LISTINGS", message -> map.takeListing(Messages.listing(message), nowMs()));
    timer.schedule(new TimerTask() {
      @Override
      public void run() {
        pull();
      }
    }, TICK_MS, TICK_MS);
  }

  static long nowMs() {
    return System.nanoTime() / 1_000_000;
  }

  MapCopy map() {
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
        // Anyone may send anything, and digests are of two types; what is lost by it is pulled.
      }
    });
  }

  private static byte[] bytes(LCMDataInputStream in) throws IOException {
    byte[] bytes = new byte[in.available()];
    in.readFully(bytes);
    return bytes;
  }

  private void pull() {
    try {
      for (layer_pull_t pull : map.pulls(nowMs())) lcm.publish(prefix + "_PULLS", pull);
      if (map.asksForControls(nowMs())) lcm.publish(prefix + "_CONTROL", nothingKnown());
    } catch (IllegalStateException e) {
      timer.cancel();  // closed meanwhile
    }
  }

  private control_records_t nothingKnown() {
    control_records_t ask = new control_records_t();
    ask.sender = sender;
    ask.records = new layer_control_t[0];
    return ask;
  }
}
