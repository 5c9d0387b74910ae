//! What the user sees while a run goes on.

use crate::console::{debug, print, say, tell, warning};
use crate::logging;
use indicatif::{ProgressBar, ProgressState, ProgressStyle};
use loopbox::run::{FrameRow, Progress, RunRecord, state_name};
use loopbox::{Level, counted};
use serde::Serialize;
use serde_json::{Map, Value, json};
use slam_direct::Frame;
use sources::ahead::Skip;
use sources::notice::Notice;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;
use std::time::Duration;

/// How progress is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Display {
    /// A bar on standard error, a summary on standard output.
    Bar,
    /// Only warnings and errors.
    Quiet,
    /// One JSON object a line on standard output.
    Json,
}

/// Shows progress.
pub struct Console {
    display: Display,
    /// Standard output is for the numbers as JSON alone.
    json: bool,
    bar: ProgressBar,
    /// What became of frames that were not tracked, for the bar.
    losses: RefCell<String>,
    /// How often something of a kind was said.
    repeats: RefCell<BTreeMap<String, u64>>,
}

/// The result to look at.
pub const REPORT: &str = "report.html";
/// Something of a kind is said so often; after that it is counted.
const REPETITIONS: u64 = 3;

impl Console {
    /// Progress through `frames` frames (`None`: unknown).
    pub fn new(display: Display, frames: Option<u64>) -> Self {
        let bar = match (display, frames) {
            (Display::Bar, Some(frames)) => ProgressBar::new(frames)
                .with_style(style("{bar:30} {pos}/{len} frames  {rate:>14}  eta {eta:>4}  {msg}")),
            (Display::Bar, None) => {
                ProgressBar::new_spinner().with_style(style("{spinner} {pos} frames  {rate:>14}  {msg}"))
            }
            _ => ProgressBar::hidden(),
        };
        // A bar would stand among the lines of a log.
        let bar = if logging::is_on() { ProgressBar::hidden() } else { bar };
        if display == Display::Bar {
            bar.enable_steady_tick(Duration::from_millis(200));
        }
        Self { display, json: false, bar, losses: RefCell::default(), repeats: RefCell::default() }
    }

    /// With the numbers as one JSON object on standard output, and all else on standard error.
    pub fn with_json(mut self, json: bool) -> Self {
        self.json = json;
        self
    }

    /// Whether there is a bar that nobody sees, as where the output goes into a file.
    pub fn is_unseen(&self) -> bool {
        self.display == Display::Bar && self.bar.is_hidden() && !logging::is_on()
    }

    /// A text that is to be said; the last one of its kind says so.
    fn not_too_often(&self, kind: &str, text: &str) -> Option<String> {
        let mut repeats = self.repeats.borrow_mut();
        let times = repeats.entry(kind.to_owned()).or_default();
        *times += 1;
        match (*times, self.display) {
            (_, Display::Json) | (..REPETITIONS, _) => Some(text.to_owned()),
            (REPETITIONS, _) => Some(format!("{text} (more of this is only counted)")),
            _ => None,
        }
    }
}

impl Progress for Console {
    fn frame(&self, row: &FrameRow, keyframes: usize, points: usize) {
        match self.display {
            Display::Bar => {
                self.bar.set_position(row.index + 1);
                self.bar.set_message(format!(
                    "{}  {keyframes} keyframes  {points} sparse points{}",
                    state_name(row.state),
                    self.losses.borrow()
                ));
            }
            Display::Quiet => {}
            Display::Json => log_line(&json!({
                "event": "frame", "frame": row, "keyframes": keyframes, "points": points,
            })),
        }
    }

    fn looked_at(&self, frame: &Frame) {
        if self.display == Display::Bar {
            self.bar.set_position(frame.index + 1);
        }
    }

    fn skipped(&self, skip: &Skip) {
        match self.display {
            Display::Json => log_line(&json!({
                "event": "skip", "index": skip.index, "timestamp": skip.timestamp,
                "reason": skip.reason, "detail": skip.detail,
            })),
            _ => self.warn_of(
                &format!("{:?}", skip.reason),
                &format!("frame {} is skipped: {}", skip.index, skip.detail),
            ),
        }
    }

    fn lost(&self, dropped: u64, missed: u64) {
        if self.display == Display::Bar && dropped + missed > 0 {
            let missed = if missed > 0 { format!("  {missed} missed by the driver") } else { String::new() };
            *self.losses.borrow_mut() = format!("  {dropped} dropped{missed}");
        }
    }

    fn notice(&self, notice: &Notice) {
        let event = match notice {
            Notice::Warning(text) => return self.warn(text),
            Notice::Note(_) => "note",
            Notice::Gone(_) => "gone",
            Notice::Back(_) => "back",
        };
        match self.display {
            Display::Quiet if event == "note" => {}
            Display::Bar | Display::Quiet => {
                let level = if event == "gone" { Level::Warn } else { Level::Info };
                self.bar.suspend(|| logging::write(level, "", format_args!("{}", notice.text())));
            }
            Display::Json => log_line(&json!({ "event": event, "text": notice.text() })),
        }
    }

    fn warn_of(&self, kind: &str, text: &str) {
        if let Some(text) = self.not_too_often(kind, text) {
            self.warn(&text);
        }
    }

    fn note_of(&self, kind: &str, text: &str) {
        let times = self.repeats.borrow().get(kind).copied().unwrap_or_default();
        match self.display {
            Display::Json => self.note(text),
            // Where the warning stood.
            _ if times <= REPETITIONS => self.bar.suspend(|| tell!("{text}")),
            _ => {}
        }
    }

    fn warn(&self, text: &str) {
        match self.display {
            Display::Bar => self.bar.suspend(|| warning!("{text}")),
            Display::Quiet => warning!("{text}"),
            Display::Json => log_line(&json!({ "event": "warning", "text": text })),
        }
    }

    fn note(&self, text: &str) {
        match self.display {
            Display::Bar if self.json => self.bar.suspend(|| tell!("{text}")),
            Display::Bar => self.bar.suspend(|| say!("{text}")),
            Display::Quiet => {}
            Display::Json => log_line(&json!({ "event": "note", "text": text })),
        }
    }

    fn stage(&self, text: &str) {
        match self.display {
            Display::Bar => {
                debug!("{text}");
                self.bar.set_message(text.to_owned());
            }
            Display::Quiet => {}
            Display::Json => log_line(&json!({ "event": "stage", "text": text })),
        }
    }

    fn mapped(&self, record: &RunRecord, folder: &Path) {
        let out = &folder.display().to_string();
        self.bar.finish_and_clear();
        match self.display {
            _ if self.json => print_numbers(record, folder),
            Display::Bar => say!("{}", summary(record, out).trim_end()),
            Display::Quiet => {}
            Display::Json => log_line(&json!({
                "event": "end", "out": out, "interrupted": record.interrupted, "frames": record.frames,
                "cost": record.cost, "map": record.map,
            })),
        }
    }
}

impl Drop for Console {
    fn drop(&mut self) {
        // After an error the bar must not stand before its message.
        self.bar.finish_and_clear();
    }
}

/// A bar over frames that are copied.
pub fn frame_bar(quiet: bool, frames: Option<u64>) -> ProgressBar {
    match (quiet, frames) {
        (true, _) => ProgressBar::hidden(),
        (false, Some(frames)) => {
            ProgressBar::new(frames).with_style(style("{bar:30} {pos}/{len} frames  {rate:>14}"))
        }
        (false, None) => ProgressBar::new_spinner().with_style(style("{spinner} {pos} frames  {rate:>14}")),
    }
}

fn style(template: &str) -> ProgressStyle {
    let rate = |state: &ProgressState, out: &mut dyn Write| {
        // What cannot be written into a line of the terminal is not seen.
        let _ = write!(out, "{}", rate_text(state.per_sec()));
    };
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    style.with_key("rate", rate)
}

/// Frames a second, as a line of the terminal has room for.
fn rate_text(per_second: f64) -> String {
    format!("{per_second:.1} frames/s")
}

/// Prints what `run.json` has as one object, but for its rows of single frames, and with the folder of results.
pub fn print_numbers(record: &impl Serialize, folder: &Path) {
    // By its text: a number of 32 bits then has as many digits as in the file.
    let numbers = || -> anyhow::Result<()> {
        let mut fields: Map<String, Value> = serde_json::from_str(&serde_json::to_string(record)?)?;
        fields.remove("rows");
        fields.insert("out".into(), folder.display().to_string().into());
        print(&(serde_json::to_string_pretty(&fields)? + "\n"))
    };
    if let Err(error) = numbers() {
        warning!("{}", loopbox::explained(&error));
    }
}

fn log_line(value: &serde_json::Value) {
    say!("{value}");
}

fn summary(record: &RunRecord, out: &str) -> String {
    let (frames, cost, map) = (&record.frames, &record.cost, &record.map);
    let mut text = format!(
        "{} of {} frames tracked ({:.1} %), {}, {}, {}\n\
         {:.1} frames/s, {:.1} ms a frame (99 %: {:.1} ms)",
        frames.tracked,
        frames.offered - frames.dropped_late,
        100.0 * frames.tracked_share,
        counted(map.keyframes, "keyframe", "keyframes"),
        counted(map.semi_dense, "point", "points"),
        counted(map.loops, "loop", "loops"),
        cost.frames_per_s,
        cost.mean_ms,
        cost.p99_ms,
    );
    if let Some(bytes) = cost.peak_memory_bytes {
        text += &format!(", {} MiB", bytes >> 20);
    }
    text.push('\n');
    let skipped: u64 = frames.skipped.values().sum();
    if skipped > 0 {
        let kinds: Vec<String> = frames.skipped.iter().map(|(reason, n)| format!("{n} {reason}")).collect();
        text += &format!("{} skipped: {}\n", counted(skipped, "frame", "frames"), kinds.join(", "));
    }
    if let Some(left_out) = record.left_out {
        text += &format!("{}\n", left_out.text());
    }
    for apart in record.fragments.iter().skip(1) {
        text += &format!(
            "{}, from {} to {}, in {}: a fragment that shares no place with the rest\n",
            counted(apart.frames, "more frame", "more frames"),
            apart.first_frame,
            apart.last_frame,
            apart.trajectory
        );
    }
    if frames.doubted > 0 {
        text += &format!(
            "{} frames resemble a part of the map and have no pose: what they see does not confirm that it is that place\n",
            frames.doubted
        );
    }
    text += &missing_frames(record);
    if record.interrupted {
        text += "interrupted: what was tracked so far is saved\n";
        if !record.files.is_empty() && !record.files.iter().any(|name| name.ends_with(".ply")) {
            text += &format!("the map is left as it has grown: `loopbox export {out}` makes its cloud\n");
        }
    }
    text += &format!("written to {out}\n");
    if record.files.iter().any(|name| name == REPORT) {
        text += &format!("open {} in a browser\n", Path::new(out).join(REPORT).display());
    }
    text
}

/// Frames that were lost, dropped or missed, and how long those took that were not.
fn missing_frames(record: &RunRecord) -> String {
    let (frames, cost) = (&record.frames, &record.cost);
    let mut text = String::new();
    if frames.losses > 0 {
        text += &format!("times lost: {}\n", frames.losses_text());
    }
    if frames.dropped_late > 0 {
        text += &format!(
            "{} dropped because tracking was late\n",
            counted(frames.dropped_late, "frame", "frames")
        );
    }
    if frames.missed_by_driver > 0 {
        text += &format!(
            "{} missed by the camera's driver\n",
            counted(frames.missed_by_driver, "frame", "frames")
        );
    }
    if let Some(latency) = cost.latency_ms {
        text += &format!(
            "{:.1} ms from image to pose (99 %: {:.1} ms, longest {:.1} ms)\n",
            latency.median, latency.p99, latency.max
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_has_one_decimal() {
        assert_eq!(rate_text(74.740_845_035), "74.7 frames/s");
    }
}
