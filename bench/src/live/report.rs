//! What the documents say of cameras.

use super::calibration::{Apart, Calibrated, HeldOut, Misfit, Parameter};
use super::client::Viewer;
use super::latency::Timed;
use super::long::{Long, RATE, SEQUENCE as LONG_SEQUENCE};
use super::replay::Replayed;
use super::shares::{Cost, Extra, SEQUENCE as COST_SEQUENCE};
use super::{Live, Part};
use crate::measure::Run;
use crate::report::{MISSING, length, number};
use measuring::median;
use std::fmt::Write;

/// The page's share of the CPU time must stay below this, percent.
const PAGE_SHARE: f64 = 5.0;

/// All tables.
pub fn section(live: &Live) -> String {
    let parts = [
        part("Latency and dropped frames", &live.timed, |timed| latency(timed)),
        part("Minutes on end", &live.long, long),
        costs(&live.costs),
        part("Replay", &live.replays, |replays| replay(replays)),
        calibrations(&live.calibrations),
    ];
    parts.concat()
}

/// The table of what recording and watching cost.
pub fn costs(found: &Part<Vec<Cost>>) -> String {
    part("Recording and watching", found, |costs| shares(costs))
}

/// The tables of calibration.
pub fn calibrations(found: &Part<Vec<Calibrated>>) -> String {
    part("Calibration", found, |all| all.iter().map(calibration).collect())
}

fn part<T>(title: &str, measured: &Part<T>, text: impl FnOnce(&T) -> String) -> String {
    let text = measured.as_ref().map_or_else(|reason| format!("Not measured: {reason}\n"), text);
    format!("### {title}\n\n{}\n\n", text.trim())
}

fn table(columns: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let mut out = format!("| {} |\n|{}\n", columns.join(" | "), "---|".repeat(columns.len()));
    for row in rows {
        let _ = writeln!(out, "| {} |", row.join(" | "));
    }
    out + "\n"
}

fn latency(all: &[Timed]) -> String {
    let row = |timed: &Timed| {
        let ms = |name: &str| {
            let pointer = format!("/cost/latency_ms/{name}");
            move |run: &Run| run.record(&pointer)
        };
        let ate = |run: &Run| run.evaluation("/ate/rmse");
        let of_ate = |value: Option<f64>| value.map_or(MISSING.into(), length);
        vec![
            format!("`{}`", timed.name),
            timed.live.len().to_string(),
            number(timed.median(ms("median")), 1, " ms"),
            number(timed.median(ms("p99")), 1, " ms"),
            number(timed.worst(ms("max")), 1, " ms"),
            share(timed.median(|run| run.record("/frames/dropped_late")), &timed.live[0]),
            number(timed.worst(|run| run.record("/frames/losses")), 0, ""),
            of_ate(timed.handed_out.iter().copied().collect::<Option<_>>().and_then(median)),
            of_ate(timed.median(ate)),
            of_ate(ate(&timed.offline)),
        ]
    };
    let columns = [
        "sequence, 30 Hz",
        "runs",
        "latency, median",
        "99th percentile",
        "longest",
        "frames dropped",
        "losses",
        "ATE RMSE, as handed out",
        "in the end",
        "with all frames",
    ];
    table(&columns, all.iter().map(row))
}

/// A number of frames, and what part it is of those that came.
fn share(count: Option<f64>, run: &Run) -> String {
    match (count, run.record("/frames/offered")) {
        (Some(count), Some(all)) => format!("{count:.0} of {all:.0} ({:.1} %)", 100.0 * count / all),
        _ => MISSING.to_owned(),
    }
}

fn long(long: &Long) -> String {
    let run = &long.run;
    let ms = |name: &str| number(run.record(&format!("/cost/latency_ms/{name}")), 1, " ms");
    let frames: u64 = long.minutes.iter().map(|minute| minute.frames).sum();
    let mut out = format!(
        "`{LONG_SEQUENCE}` played forwards and backwards for {:.1} minutes at {RATE:.0} Hz; to the end and back takes \
         {} frames.\n\n",
        frames as f64 / RATE / 60.0,
        long.period,
    );
    let row = vec![
        share(run.record("/frames/dropped_late"), run),
        ms("median"),
        ms("p99"),
        ms("max"),
        number(run.record("/frames/losses"), 0, ""),
        run.evaluation("/ate/rmse").map_or(MISSING.into(), length),
        number(run.record("/map/keyframes"), 0, ""),
        number(run.record("/cost/peak_memory_bytes").map(|bytes| bytes / 1e6), 0, " MB"),
    ];
    let columns = [
        "frames dropped",
        "latency, median",
        "99th percentile",
        "longest",
        "losses",
        "ATE RMSE",
        "keyframes at the end",
        "peak memory",
    ];
    out += &table(&columns, [row]);
    let minutes = long.minutes.iter().enumerate().map(|(i, minute)| {
        vec![
            (i + 1).to_string(),
            (minute.frames - minute.processed.min(minute.frames)).to_string(),
            number(minute.median_ms, 1, " ms"),
            number(minute.p99_ms, 1, " ms"),
            minute.keyframes.to_string(),
        ]
    });
    let columns = ["minute", "frames dropped", "latency, median", "99th percentile", "keyframes made"];
    out + &table(&columns, minutes)
}

fn shares(all: &[Cost]) -> String {
    let Some(plain) = all.iter().find(|cost| cost.extra == Extra::Nothing) else { return String::new() };
    let mut out = format!(
        "`{COST_SEQUENCE}`, every frame processed so that all runs do the same work, which takes {}; medians of {} runs \
         each, made in turns. *Added* is to the CPU time of the plain run of the same turn.\n\n",
        number(plain.median(|run| run.record("/cost/wall_s")), 0, " s"),
        plain.runs.len()
    );
    let row = |cost: &Cost| {
        let added = cost.added(plain).filter(|_| cost.extra != Extra::Nothing);
        let is_page = cost.extra == Extra::Watched(Viewer::Page);
        let reached =
            added.filter(|_| is_page).map(|[_, added, _]| if added < PAGE_SHARE { "yes" } else { "**no**" });
        let range = |[least, _, most]: [f64; 3]| format!("{least:+.1} … {most:+.1} %");
        vec![
            what(cost.extra).to_owned(),
            number(cost.cpu_s(), 2, " s"),
            signed(added.map(|[_, median, _]| median), 1, " %"),
            added.map_or(MISSING.to_owned(), range),
            if is_page { format!("< {PAGE_SHARE} %") } else { MISSING.to_owned() },
            reached.unwrap_or(MISSING).to_owned(),
        ]
    };
    let columns = ["", "CPU", "added", "in single runs", "to reach", "reached"];
    out += &table(&columns, all.iter().map(row));
    for cost in all {
        if let Some(bytes) = cost.bytes_per_frame() {
            let _ = writeln!(out, "The recording holds {:.1} kB a frame.", bytes / 1e3);
        }
        if let Some([messages, pictures, bytes]) = cost.received_a_second() {
            let images =
                if pictures > 0.0 { format!(", {pictures:.1} of them images") } else { String::new() };
            let _ = writeln!(
                out,
                "With {} the viewer got {messages:.0} messages a second{images}, {:.2} MB/s.",
                what(cost.extra),
                bytes / 1e6
            );
        }
    }
    out
}

fn what(extra: Extra) -> &'static str {
    match extra {
        Extra::Nothing => "plain",
        Extra::Record => "`--record`",
        Extra::Watched(Viewer::Page) => "`--view`, one page open",
        Extra::Watched(Viewer::Foxglove) => "`--foxglove`, all channels subscribed",
    }
}

fn signed(value: Option<f64>, digits: usize, unit: &str) -> String {
    value.filter(|v| v.is_finite()).map_or(MISSING.into(), |v| format!("{v:+.digits$}{unit}"))
}

fn replay(all: &[Replayed]) -> String {
    let yes = |same| if same { "yes" } else { "**no**" }.to_owned();
    let row = |replayed: &Replayed| {
        vec![
            replayed.what.clone(),
            number(replayed.processed, 0, ""),
            number(replayed.dropped, 0, ""),
            yes(replayed.trajectory),
            yes(replayed.cloud),
            yes(replayed.map),
        ]
    };
    let columns = [
        "run, and what was run again",
        "frames processed",
        "dropped",
        "same trajectory.txt",
        "same cloud.ply",
        "same map",
    ];
    table(&columns, all.iter().map(row))
}

fn calibration(found: &Calibrated) -> String {
    let known = found.known;
    let [used, given] = found.images;
    let mut out = format!("`{}`: {used} of {given} images used, {:.1} s.\n\n", known.name, found.seconds);
    let reached = |reached| if reached { "yes" } else { "**no**" }.to_owned();
    let row = |parameter: &Parameter| {
        let digits = digits(parameter.sigma);
        vec![
            parameter.name.clone(),
            format!("{:.digits$} ± {:.digits$}", parameter.value, parameter.sigma),
            parameter.known.map_or(MISSING.into(), |known| known.to_string()),
            signed(parameter.percent(), 2, " %"),
            signed(parameter.sigmas(), 1, " σ"),
            number(parameter.moves, 2, " px"),
            parameter.wanted.map_or(MISSING.into(), |percent| format!("≤ {percent} %")),
            parameter.is_reached().map_or(MISSING.into(), reached),
        ]
    };
    let rms = vec![
        "RMS".to_owned(),
        format!("{:.3} px", found.rms),
        MISSING.into(),
        MISSING.into(),
        MISSING.into(),
        MISSING.into(),
        format!("≤ {} px", known.rms),
        reached(found.rms <= known.rms),
    ];
    let columns =
        ["", "found", "known", "difference", "in σ found", "moves the border by", "to reach", "reached"];
    out += &table(&columns, found.parameters.iter().map(row).chain([rms]));
    if let Some(Apart { inner, whole }) = found.apart {
        let _ = writeln!(
            out,
            "All parameters together: turned to agree best, both cameras have the same ray {:.2} px apart (root mean \
             square; at most {:.2} px) a tenth of the image and more from its border, {:.2} px (at most {:.1} px) over the \
             whole image, at whose border few corners were seen.\n",
            inner.rms, inner.most, whole.rms, whole.most
        );
    }
    out + &held_out(&found.held_out)
}

fn held_out(found: &HeldOut) -> String {
    let text = |error: Misfit| format!("{:.3} px (median {:.3} px)", error.rms, error.median);
    let known = found.known.map_or(String::new(), |error| format!(", by the known camera {}", text(error)));
    format!(
        "On the half of the images that it was not made from, a calibration leaves {}{known}: root mean square over all \
         corners found there, with the board placed in each image and nothing set aside.\n\n",
        text(found.found)
    )
}

/// Decimals that show two figures of a standard deviation.
fn digits(sigma: f64) -> usize {
    if sigma > 0.0 { (1.0 - sigma.log10().floor()).clamp(0.0, 8.0) as usize } else { 6 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_that_failed_says_why_in_its_place() {
        let failed = || Err("latency: no room".to_owned());
        let live = Live {
            calibrations: Ok(Vec::new()),
            timed: failed(),
            costs: Ok(Vec::new()),
            replays: Ok(vec![Replayed {
                what: "`a`: all frames".into(),
                processed: Some(3.0),
                dropped: None,
                trajectory: true,
                cloud: false,
                map: true,
            }]),
            long: Err("the long run: no images".into()),
        };
        let text = section(&live);
        assert!(
            text.contains("### Latency and dropped frames\n\nNot measured: latency: no room\n"),
            "{text}"
        );
        assert!(text.contains("| `a`: all frames | 3 | – | yes | **no** | yes |"), "{text}");
        assert_eq!(live.problems().len(), 3);
    }

    #[test]
    fn differences_show_their_sign() {
        assert_eq!(signed(Some(4.0), 1, " %"), "+4.0 %");
        assert_eq!(signed(Some(-10.0), 1, " %"), "-10.0 %");
        assert_eq!(signed(None, 1, " %"), MISSING);
        assert_eq!((digits(0.4), digits(0.0000012)), (2, 7));
    }
}
