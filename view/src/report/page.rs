//! A page that holds everything it needs: what every report is made of.

use super::script::{Script, link};
use crate::script;
use anyhow::Context;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;
use serde_json::ser::{Formatter, Serializer};
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// What is around every page's body.
const SHELL: &str = include_str!("assets/shell.html");
/// What the policies of all pages begin with.
const DEFAULT_POLICY: &str = "default-src 'none'";
/// Styles of every page.
const STYLE: &str = include_str!("assets/page.css");
/// The 3-D view.
const VIEWER: &str = include_str!("assets/viewer.html");
/// The scripts of every page: numbers, colours, data, drawing.
const SCRIPTS: [Script; 3] =
    [script!("assets/numbers.js"), script!("assets/colours.js"), script!("assets/page.js")];
/// Scripts of pages that show a scene: what is known of it, the 3-D view and its tools, plots.
const SCENE_SCRIPTS: [Script; 17] = [
    script!("assets/vectors.js"),
    script!("assets/scene.js"),
    script!("assets/gl.js"),
    script!("assets/cloud.js"),
    script!("assets/survey.js"),
    script!("assets/camera.js"),
    script!("assets/points.js"),
    script!("assets/measure.js"),
    script!("assets/playing.js"),
    script!("assets/files.js"),
    script!("assets/overlays.js"),
    script!("assets/viewer.js"),
    script!("assets/player.js"),
    script!("assets/tools.js"),
    script!("assets/controls.js"),
    script!("assets/chart.js"),
    script!("assets/tabular.js"),
];

/// What one page has beyond the others.
#[derive(Clone, Copy, Debug)]
pub struct Template {
    /// The body, with a mark `{{viewer}}` where the 3-D view goes and `{{title}}` for the heading.
    pub body: &'static str,
    /// Styles of its own.
    pub style: &'static str,
    /// What its content policy allows beyond the others', from a `;` on.
    pub policy: &'static str,
    /// Whether it shows a scene, which its data then hold.
    pub scene: bool,
    /// Scripts of its own, in their order; the last one starts the page.
    pub scripts: &'static [Script],
}

impl Template {
    /// The whole page as text.
    ///
    /// # Errors
    /// When the data cannot be written as JSON, or the scripts do not fit each other.
    pub fn filled(&self, title: &str, data: &impl Serialize) -> anyhow::Result<String> {
        let mut page = Vec::new();
        self.write(title, data, &mut page)?;
        String::from_utf8(page).context("the page is no text")
    }

    /// Writes the whole page to `page`, the data bit by bit: there may be more of them than there is memory for.
    ///
    /// # Errors
    /// As [`filled`](Self::filled), and when `page` cannot be written.
    pub fn write(&self, title: &str, data: &impl Serialize, page: &mut dyn Write) -> anyhow::Result<()> {
        let title = html_escaped(title);
        let of_scene: &[Script] = if self.scene { &SCENE_SCRIPTS } else { &[] };
        let scripts = link(SCRIPTS.iter().chain(of_scene).chain(self.scripts))?;
        // As they stand between the tags: the policy has their hashes.
        let script = format!("\n\"use strict\";\n(() => {{\n{scripts}}})();\n");
        let style = format!("\n{STYLE}{}", self.style);
        let values = [
            ("title", &*title),
            ("policy", &*policy(&style, &script, self.policy)),
            ("style", &style),
            ("body", &fill(self.body, &[("title", &title), ("viewer", VIEWER)])),
            ("script", &script),
        ];
        let (before, after) = SHELL.split_once("{{data}}").unwrap_or((SHELL, ""));
        page.write_all(fill(before, &values).as_bytes())?;
        data.serialize(&mut Serializer::with_formatter(&mut *page, ScriptSafe))
            .context("the report's data cannot be written as JSON")?;
        Ok(page.write_all(fill(after, &values).as_bytes())?)
    }
}

/// What a page may do: run its own script, use its own style, show what is in it, and `more`.
fn policy(style: &str, script: &str, more: &str) -> String {
    format!(
        "{DEFAULT_POLICY}; img-src data:; style-src {}; script-src {}; base-uri 'none'; form-action 'none'{more}",
        allowed(style),
        allowed(script)
    )
}

/// What allows this text alone, as a policy writes it.
pub fn allowed(text: &str) -> String {
    format!("'sha256-{}'", STANDARD.encode(Sha256::digest(text)))
}

/// The policy that stands in a page, for who serves it to say it too.
pub fn policy_of(page: &str) -> Option<&str> {
    let begins = page.find(DEFAULT_POLICY)?;
    let policy = page[begins..].split('"').next()?;
    policy.bytes().all(|byte| (b' '..0x7f).contains(&byte)).then_some(policy)
}

/// Writes a page to `path`, replacing what was there.
///
/// # Errors
/// When the file cannot be written.
pub fn save(path: &Path, html: &str) -> anyhow::Result<()> {
    write(path, |page| Ok(page.write_all(html.as_bytes())?))
}

/// Has a page written to `path`, replacing what was there.
///
/// # Errors
/// When the file cannot be written, or `fill` fails.
pub fn write(path: &Path, fill: impl FnOnce(&mut dyn Write) -> anyhow::Result<()>) -> anyhow::Result<()> {
    let hint = || {
        format!(
            "cannot write the report to {}: check that the folder exists and the disk has room",
            path.display()
        )
    };
    let mut page = BufWriter::new(File::create(path).with_context(hint)?);
    fill(&mut page).with_context(hint)?;
    page.flush().with_context(hint)
}

/// Puts values into the `{{name}}` marks of a template; values are not searched for marks again.
pub fn fill(template: &str, values: &[(&str, &str)]) -> String {
    let mut out = String::with_capacity(template.len() + values.iter().map(|(_, v)| v.len()).sum::<usize>());
    let mut rest = template;
    while let Some((before, after)) = rest.split_once("{{") {
        let (name, after) = after.split_once("}}").unwrap_or((after, ""));
        out.push_str(before);
        out.push_str(values.iter().find(|(n, _)| *n == name).map_or("", |(_, value)| value));
        rest = after;
    }
    out.push_str(rest);
    out
}

/// Text made harmless inside an HTML element or attribute.
pub fn html_escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            _ => out.push(c),
        }
    }
    out
}

/// JSON made harmless inside a `<script>` element: these characters occur only within its strings,
/// where `\u` escapes mean the same.
struct ScriptSafe;

impl Formatter for ScriptSafe {
    fn write_string_fragment<W: Write + ?Sized>(&mut self, writer: &mut W, fragment: &str) -> io::Result<()> {
        writer.write_all(script_safe(fragment).as_bytes())
    }
}

/// The same of what is within a string.
fn script_safe(json: &str) -> String {
    let mut out = String::with_capacity(json.len());
    for part in json.split_inclusive(['<', '>', '&']) {
        let mark = part.chars().next_back().filter(|c| "<>&".contains(*c));
        out.push_str(&part[..part.len() - mark.map_or(0, char::len_utf8)]);
        if let Some(c) = mark {
            out.push_str(&format!("\\u{:04x}", c as u32));
        }
    }
    out
}
