//! Tables of what was measured.

use crate::measure::{Measurement, Run};
use crate::targets::{images, target};
use std::fmt::Write;

/// A number that was not given.
pub const MISSING: &str = "–";

/// The column of DSO's figures.
const DSO: &str = "DSO: ATE · tracked · CPU per frame, on another machine";

/// One line for the terminal.
pub fn line(m: &Measurement) -> String {
    match &m.failure {
        Some(failure) => format!("{:<20} FAILED: {failure}", m.name),
        None => {
            let cells = [ate(m), tracked(m), cpu_per_frame(m), rates(m), identical(m).to_owned()];
            format!("{:<20} {}", m.name, cells.join("  "))
        }
    }
}

/// The tables of the results page.
pub fn results(all: &[Measurement], runs: usize) -> String {
    let mut out = format!(
        "Medians of {runs} runs. ATE is the root mean square over all frames with ground truth after one \
         Sim(3) alignment; *same* says whether trajectory, map and cloud of all runs, the one on one core \
         included, are equal byte by byte.\n\n"
    );
    let accuracy = |m: &Measurement| {
        let reach = target(&m.name).map_or(MISSING.into(), |t| format!("≤ {}", length(t.ate_m)));
        let dso = target(&m.name).map_or(MISSING, |t| t.dso).to_owned();
        let losses = counted(m, "/frames/losses");
        vec![images(&m.name).to_owned(), ate(m), reach, tracked(m), losses, identical(m).to_owned(), dso]
    };
    let columns = ["images", "ATE RMSE", "to reach", "frames tracked", "losses", "same", DSO];
    table(&mut out, &columns, all, accuracy);
    let speed = |m: &Measurement| {
        let ms = |pointer| number(m.median(|r| r.record(pointer)), 1, " ms");
        let reach = target(&m.name).map_or(MISSING.into(), |t| format!("≤ {} ms", t.cpu_ms));
        let cpu = number(m.median(|r| r.record("/cost/cpu_s")), 1, " s");
        vec![cpu_per_frame(m), reach, cpu, ms("/cost/mean_ms"), ms("/cost/p99_ms"), rates(m)]
    };
    let columns =
        ["CPU per frame", "to reach", "CPU", "mean", "99th percentile", "frames/s on 1 · all cores"];
    table(&mut out, &columns, all, speed);
    let size = |m: &Measurement| {
        let memory = number(m.median(|r| Some(r.record("/cost/peak_memory_bytes")? / 1e6)), 0, " MB");
        let map = |name: &str| counted(m, &format!("/map/{name}"));
        vec![memory, map("keyframes"), map("points"), map("semi_dense"), map("loops")]
    };
    table(&mut out, &["peak memory", "keyframes", "points", "depths", "loops closed"], all, size);
    if all.iter().any(|m| m.median(depth("median_relative_error")).is_some()) {
        out.push_str(
            "Depth over the points that the map exports, relative error of the inverse depth after one scale \
             for the whole map. To reach: median ≤ 1 %, outliers ≤ 3 %, density ≥ 8 %.\n\n",
        );
        let with_depth = all.iter().filter(|m| m.median(depth("median_relative_error")).is_some());
        let quality = |m: &Measurement| {
            let share = |name, digits| number(m.median(|r| Some(100.0 * depth(name)(r)?)), digits, " %");
            let points = number(m.median(depth("count")), 0, "");
            let (median, outliers) = (share("median_relative_error", 2), share("outlier_share", 2));
            vec![median, outliers, share("density", 1), share("exported_density", 1), points]
        };
        let columns = ["median error", "outliers (> 10 %)", "density", "density exported", "points compared"];
        table(&mut out, &columns, with_depth, quality);
    }
    for m in all {
        if let Some(failure) = &m.failure {
            let _ = writeln!(out, "`{}` failed: {failure}\n", m.name);
        }
    }
    out
}

/// The short table of the book's benchmarks.
pub fn summary(all: &[Measurement]) -> String {
    let mut out = String::new();
    let row = |m: &Measurement| {
        let dso = target(&m.name).map_or(MISSING, |t| t.dso).to_owned();
        vec![images(&m.name).to_owned(), ate(m), tracked(m), cpu_per_frame(m), rates(m), dso]
    };
    let columns = ["images", "ATE RMSE", "frames tracked", "CPU per frame", "frames/s on 1 · all cores", DSO];
    table(&mut out, &columns, all, row);
    out
}

/// What the figures were measured on.
pub fn machine() -> String {
    let cores = std::thread::available_parallelism().map_or(MISSING.to_owned(), |n| n.to_string());
    let model = std::fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| {
        let line = text.lines().find(|line| line.starts_with("model name"))?;
        Some(line.split_once(':')?.1.trim().to_owned())
    });
    format!("Measured on {cores} cores of {}.", model.as_deref().unwrap_or("an unnamed processor"))
}

fn table<'a>(
    out: &mut String,
    columns: &[&str],
    all: impl IntoIterator<Item = &'a Measurement>,
    row: impl Fn(&Measurement) -> Vec<String>,
) {
    let _ = writeln!(out, "| sequence | {} |\n|---|{}", columns.join(" | "), "---|".repeat(columns.len()));
    for m in all {
        let _ = writeln!(out, "| `{}` | {} |", m.name, row(m).join(" | "));
    }
    out.push('\n');
}

fn ate(m: &Measurement) -> String {
    m.median(|run| run.evaluation("/ate/rmse")).map_or(MISSING.to_owned(), length)
}

fn tracked(m: &Measurement) -> String {
    let count = |name| m.median(|run| run.evaluation(&format!("/coverage/{name}")));
    match (count("covered"), count("total")) {
        (Some(covered), Some(total)) => format!("{covered}/{total} ({:.1} %)", 100.0 * covered / total),
        _ => MISSING.to_owned(),
    }
}

fn cpu_per_frame(m: &Measurement) -> String {
    let per_frame = |r: &Run| Some(1e3 * r.record("/cost/cpu_s")? / r.record("/frames/processed")?);
    number(m.median(per_frame), 1, " ms")
}

fn rates(m: &Measurement) -> String {
    let rate = |run: &Run| run.record("/cost/frames_per_s");
    let one = number(m.one_core.as_ref().and_then(rate), 1, "");
    format!("{one} · {}", number(m.median(rate), 1, ""))
}

fn identical(m: &Measurement) -> &'static str {
    match (m.failure.is_some(), m.identical) {
        (true, _) => MISSING,
        (false, true) => "yes",
        (false, false) => "**no**",
    }
}

fn counted(m: &Measurement, pointer: &str) -> String {
    number(m.median(|run| run.record(pointer)), 0, "")
}

fn depth(name: &str) -> impl Fn(&Run) -> Option<f64> + '_ {
    move |run| run.evaluation(&format!("/depth/{name}"))
}

/// A length as centimetres below one metre.
pub fn length(metres: f64) -> String {
    if metres < 1.0 { format!("{:.2} cm", 100.0 * metres) } else { format!("{metres:.2} m") }
}

/// A number with its unit, or that it was not given.
pub fn number(value: Option<f64>, digits: usize, unit: &str) -> String {
    value.filter(|v| v.is_finite()).map_or(MISSING.to_owned(), |v| format!("{v:.digits$}{unit}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_were_not_given_show_as_missing() {
        let failed = Measurement {
            name: "parking_a".to_owned(),
            runs: Vec::new(),
            one_core: None,
            identical: true,
            failure: Some("no map".to_owned()),
        };
        let text = results(&[failed], 3);
        assert!(
            text.contains(
                "| `parking_a` | rendered | – | ≤ 2.00 cm | – | – | – | 1.1 cm · 327/333 · 60 ms |"
            ),
            "{text}"
        );
        assert!(text.contains("`parking_a` failed: no map"));
        assert!(!text.contains("NaN"));
    }

    /// The figures of other systems were not measured beside ours, and drawn images are not real ones: the tables say so.
    #[test]
    fn the_short_table_says_what_is_rendered_and_where_others_were_measured() {
        let sequence = |name: &str| Measurement {
            name: name.to_owned(),
            runs: Vec::new(),
            one_core: None,
            identical: true,
            failure: None,
        };
        let text = summary(&[sequence("parking_a"), sequence("tum_fr1_xyz")]);
        assert!(text.contains("on another machine") && !text.contains("same machine"), "{text}");
        assert!(
            text.contains("| `parking_a` | rendered |") && text.contains("| `tum_fr1_xyz` | real |"),
            "{text}"
        );
    }

    #[test]
    fn lengths_read_well() {
        assert_eq!(length(0.0123), "1.23 cm");
        assert_eq!(length(1.128), "1.13 m");
    }
}
