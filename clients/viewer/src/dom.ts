// Small helpers for the page. Texts go in as textContent: names come from anybody on the bus.

import { Rgb, css } from "./colours";

export function byId<T extends HTMLElement = HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`The page has no #${id}`);
  return found as T;
}

export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  className = "",
  text = "",
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text) element.textContent = text;
  return element;
}

export function swatch(colour: Rgb): HTMLElement {
  const element = make("span", "swatch");
  element.style.backgroundColor = css(colour);
  return element;
}

// Unchanged texts are left alone, so that selections and screen readers are not disturbed.
export function setText(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

export function setPressed(button: HTMLElement, isPressed: boolean): void {
  button.setAttribute("aria-pressed", String(isPressed));
}

// The buttons in a group that stand for one value each, as data-NAME.
export class Choice {
  private readonly buttons: HTMLElement[];

  constructor(
    group: HTMLElement,
    private readonly name: string,
    onChoose: (value: string) => void,
  ) {
    this.buttons = [...group.querySelectorAll<HTMLElement>(`[data-${name}]`)];
    for (const button of this.buttons) {
      button.addEventListener("click", () => onChoose(button.dataset[name]!));
    }
  }

  show(value: string): void {
    for (const button of this.buttons) setPressed(button, button.dataset[this.name] === value);
  }
}

// Keeps the children of a list in step with items: rows stay, so that focus and hover do.
export class RowList<T> {
  private readonly rows = new Map<string, { element: HTMLElement; update: (item: T) => void }>();

  constructor(
    private readonly list: HTMLElement,
    private readonly makeRow: (item: T) => { element: HTMLElement; update: (item: T) => void },
    private readonly emptyText: string,
  ) {}

  show(items: T[], keyOf: (item: T) => string): void {
    const keys = new Set(items.map(keyOf));
    for (const [key, row] of this.rows) {
      if (keys.has(key)) continue;
      row.element.remove();
      this.rows.delete(key);
    }
    this.list.querySelector(".empty")?.remove();
    items.forEach((item, k) => this.place(item, keyOf(item), k));
    if (items.length === 0) this.list.append(make("li", "empty", this.emptyText));
  }

  private place(item: T, key: string, k: number): void {
    let row = this.rows.get(key);
    if (!row) this.rows.set(key, (row = this.makeRow(item)));
    row.update(item);
    if (this.list.children[k] !== row.element) {
      this.list.insertBefore(row.element, this.list.children[k] ?? null);
    }
  }
}
