package splinemap.spy;

import com.github.luben.zstd.Zstd;
import java.awt.BorderLayout;
import java.awt.event.ActionEvent;
import java.awt.event.WindowAdapter;
import java.awt.event.WindowEvent;
import java.beans.PropertyVetoException;
import java.io.IOException;
import javax.swing.AbstractAction;
import javax.swing.Action;
import javax.swing.BorderFactory;
import javax.swing.JComponent;
import javax.swing.JDesktopPane;
import javax.swing.JFrame;
import javax.swing.JInternalFrame;
import javax.swing.JLabel;
import javax.swing.JPanel;
import javax.swing.SwingUtilities;
import javax.swing.Timer;
import javax.swing.plaf.basic.BasicInternalFrameUI;
import lcm.spy.ChannelData;
import lcm.spy.SpyPlugin;
import splinemap.layer_digest_t;
import splinemap.layer_updates_t;

/** Shows the map as it grows, in a window of lcm-spy. */
public final class MapPlugin implements SpyPlugin {
  private static final int REFRESH_MS = 200;

  /** Digests count, too: there are no updates to click on while a robot stands still. */
  @Override
  public boolean canHandle(long fingerprint) {
    return fingerprint == layer_updates_t.LCM_FINGERPRINT
        || fingerprint == layer_digest_t.LCM_FINGERPRINT;
  }

  /** lcm-spy passes null twice when it asks for the name. */
  @Override
  public Action getAction(JDesktopPane desktop, ChannelData channel) {
    return new AbstractAction("Map...") {
      @Override
      public void actionPerformed(ActionEvent event) {
        try {
          Zstd.maxCompressionLevel();  // fails where the native part is missing
          show(desktop, channel.name.replaceFirst("_[A-Z]+$", ""));
        } catch (IOException | LinkageError e) {
          fill(desktop, channel.name, new JLabel("There is no map to show: " + e));
        }
      }
    };
  }

  private static void show(JDesktopPane desktop, String channel_prefix) throws IOException {
    MapReplica replica = new MapReplica(channel_prefix);
    MapFollower map = replica.map();
    JLabel status = new JLabel(" ");
    JLabel cursor = new JLabel(" ");
    MapView view = new MapView(map, cursor::setText);
    JPanel line = new JPanel(new BorderLayout(20, 0));
    line.setBorder(BorderFactory.createEmptyBorder(3, 6, 3, 6));
    line.add(status, BorderLayout.WEST);
    line.add(cursor, BorderLayout.EAST);
    JPanel panel = new JPanel(new BorderLayout());
    panel.add(view, BorderLayout.CENTER);
    panel.add(line, BorderLayout.SOUTH);
    Timer timer = new Timer(REFRESH_MS, tick -> {
      long now_ms = MapReplica.nowMs();
      if (map.refresh(now_ms)) view.refresh();
      status.setText(map.status(now_ms));
    });
    timer.start();
    JFrame window = fill(desktop, channel_prefix + " map", panel);
    window.addWindowListener(new WindowAdapter() {
      @Override
      public void windowClosing(WindowEvent event) {
        timer.stop();
        replica.close();
        window.dispose();
      }
    });
  }

  // lcm-spy opens a window with a desktop for each viewer, so a frame in it needs no edge or title.
  private static JFrame fill(JDesktopPane desktop, String title, JComponent content) {
    JInternalFrame frame = new JInternalFrame();
    frame.setContentPane(content);
    frame.setBorder(null);
    ((BasicInternalFrameUI) frame.getUI()).setNorthPane(null);
    desktop.add(frame);
    JFrame window = (JFrame) SwingUtilities.getWindowAncestor(desktop);
    window.setTitle(title);
    window.setSize(760, 620);
    window.validate();
    frame.setVisible(true);
    try {
      frame.setMaximum(true);
    } catch (PropertyVetoException e) {
      frame.setSize(desktop.getSize());
    }
    return window;
  }
}
