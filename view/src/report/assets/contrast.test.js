import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

const style = readFileSync(new URL("./page.css", import.meta.url), "utf8");

/** The colours named at the top of the page's style: of the light page, then of the dark one. */
const themes = [...style.matchAll(/:root \{([^}]*)\}/g)].map(([, rules]) => Object.fromEntries([...rules.matchAll(/--([\w-]+): (#[0-9a-f]{6})/g)].map(([, name, colour]) => [name, colour])));

/** Relative luminance, as WCAG 2 defines it. */
function luminance(colour) {
  const [r, g, b] = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16) / 255).map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

function contrast(one, other) {
  const [low, high] = [luminance(one), luminance(other)].sort((a, b) => a - b);
  return (high + 0.05) / (low + 0.05);
}

test("text can be read on what is behind it, on light pages and dark ones", () => {
  assert.equal(themes.length, 2);
  for (const theme of themes) {
    for (const ink of ["text", "soft", "faint", "accent"]) {
      for (const ground of ["page", "card"]) {
        const ratio = contrast(theme[ink], theme[ground]);
        assert.ok(ratio >= 4.5, `--${ink} ${theme[ink]} on --${ground} ${theme[ground]}: ${ratio.toFixed(2)} : 1`);
      }
    }
    // A banner and a button that is pressed.
    for (const ink of ["text", "accent"]) assert.ok(contrast(theme[ink], theme["accent-soft"]) >= 4.5, `--${ink} on --accent-soft: ${contrast(theme[ink], theme["accent-soft"]).toFixed(2)}`);
  }
});

test("the panel over the 3-D view can be read", () => {
  // Over black and over white alike it is nearly its own colour, of which 14 % is what is behind.
  const over = (ground) => `#${[22, 28, 38].map((v) => Math.round(0.86 * v + 0.14 * ground).toString(16).padStart(2, "0")).join("")}`;
  for (const ink of ["#dde3ec", "#a3aebd", "#c9d2de"]) assert.ok(contrast(ink, over(255)) >= 4.5, `${ink}: ${contrast(ink, over(255)).toFixed(2)}`);
});
