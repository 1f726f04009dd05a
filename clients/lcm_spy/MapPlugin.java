package splinemap.spy;

import java.awt.event.ActionEvent;
import java.io.IOException;
import java.net.URI;
import java.net.http.HttpClient;
import java.net.http.HttpRequest;
import java.net.http.HttpResponse;
import java.time.Duration;
import java.util.concurrent.TimeUnit;
import javax.net.ssl.SSLException;
import javax.swing.AbstractAction;
import javax.swing.Action;
import javax.swing.JDesktopPane;
import javax.swing.JOptionPane;
import javax.swing.SwingUtilities;
import lcm.spy.ChannelData;
import lcm.spy.SpyPlugin;
import splinemap.layer_digest_t;
import splinemap.layer_scans_t;
import splinemap.layer_updates_t;

/** Opens the page of splinemap-viewer, the map as it grows, in the user's browser. */
public final class MapPlugin implements SpyPlugin {
  private static final String DEFAULT_PAGE = "http://localhost:8086/";
  private static final Duration ANSWER_TIMEOUT = Duration.ofSeconds(3);
  private static final int BROWSER_TIMEOUT_S = 5;

  /** Digests count, too: there are no scans to click on while a robot stands still. */
  @Override
  public boolean canHandle(long fingerprint) {
    return fingerprint == layer_scans_t.LCM_FINGERPRINT
        || fingerprint == layer_updates_t.LCM_FINGERPRINT
        || fingerprint == layer_digest_t.LCM_FINGERPRINT;
  }

  /** lcm-spy passes null twice when it asks for the name. */
  @Override
  public Action getAction(JDesktopPane desktop, ChannelData channel) {
    return new AbstractAction("Map in the browser") {
      @Override
      public void actionPerformed(ActionEvent event) {
        // lcm-spy has opened a window for it, which stays empty.
        SwingUtilities.getWindowAncestor(desktop).dispose();
        new Thread(MapPlugin::openOrTell).start();
      }
    };
  }

  private static void openOrTell() {
    String problem = open(System.getenv().getOrDefault("SPLINEMAP_VIEWER", DEFAULT_PAGE));
    if (problem.isEmpty()) return;
    System.err.println(problem);
    SwingUtilities.invokeLater(() -> JOptionPane.showMessageDialog(
        null, problem, "splinemap-viewer", JOptionPane.WARNING_MESSAGE));
  }

  /** What is wrong, or "" where the browser shows the page. */
  private static String open(String page) {
    try {
      if (!isAnswered(URI.create(page))) {
        return "No splinemap-viewer answers at " + page
            + "; start it beside this bus: splinemap-viewer";
      }
    } catch (IllegalArgumentException e) {
      return "SPLINEMAP_VIEWER is not the address of a page: " + page;
    }
    try {
      // java.awt.Desktop finds a browser on some desktops only.
      Process browser = new ProcessBuilder("xdg-open", page).inheritIO().start();
      // Some browsers last as long as their window.
      boolean has_ended = browser.waitFor(BROWSER_TIMEOUT_S, TimeUnit.SECONDS);
      if (!has_ended || browser.exitValue() == 0) return "";
      return "xdg-open opened no browser; open this page in one: " + page;
    } catch (IOException | InterruptedException e) {
      return "There is no xdg-open; install xdg-utils, or open this page in a browser: " + page;
    }
  }

  private static boolean isAnswered(URI page) {
    HttpRequest request =
        HttpRequest.newBuilder(page.resolve("/healthz")).timeout(ANSWER_TIMEOUT).build();
    HttpClient client = HttpClient.newBuilder().connectTimeout(ANSWER_TIMEOUT).build();
    try {
      HttpResponse<String> answer = client.send(request, HttpResponse.BodyHandlers.ofString());
      return answer.body().strip().equals("ok");
    } catch (SSLException e) {
      return true;  // a certificate that the user may tell the browser to trust
    } catch (IOException | InterruptedException e) {
      return false;
    }
  }
}
