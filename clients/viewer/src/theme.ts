import { Theme } from "./colours";

const kStored = "splinemap-theme";

// The user's choice, or else the system's, which may change at any time.
export class ThemeChoice {
  private readonly systemIsDark = matchMedia("(prefers-color-scheme: dark)");
  private chosen: Theme | null;

  constructor(private readonly onChange: () => void) {
    const stored = readStored();
    this.chosen = stored === "light" || stored === "dark" ? stored : null;
    this.systemIsDark.addEventListener("change", () => this.apply());
    document.documentElement.dataset.theme = this.theme();
  }

  theme(): Theme {
    return this.chosen ?? (this.systemIsDark.matches ? "dark" : "light");
  }

  toggle(): void {
    this.choose(this.theme() === "light" ? "dark" : "light");
  }

  choose(theme: Theme): void {
    this.chosen = theme;
    try {
      localStorage.setItem(kStored, theme);
    } catch {
      // Storage is off: the choice lasts as long as the page.
    }
    this.apply();
  }

  private apply(): void {
    document.documentElement.dataset.theme = this.theme();
    this.onChange();
  }
}

function readStored(): string | null {
  try {
    return localStorage.getItem(kStored);
  } catch {
    return null;
  }
}
