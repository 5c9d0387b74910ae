//! What the document says of many agents.

use super::{Measured, Merge};
use std::fmt::Write;

/// A merge in a line.
pub fn line(merge: &Merge) -> String {
    let pairs = &merge.pairs;
    format!(
        "{:.1} s, {:.0} MB; {} pairs, {} related, {} merged ({} of the related), {} wrong; {} maps together; {}",
        merge.seconds,
        merge.memory / 1e6,
        pairs.all,
        pairs.related,
        pairs.merged,
        pairs.found,
        pairs.wrong,
        merge.together,
        merge.cost
    )
}

/// The section of the document.
pub fn section(measured: &Measured, agents: usize, keyframes: usize) -> String {
    let mut text = format!(
        "{agents} maps of {keyframes} keyframes of 320 × 240 pixels each, of ways of {:.0} m through a rendered town on which each \
         agent begins a quarter of its way after the one before; each image has noise and its agent's own exposure, each depth noise, \
         each map drift, a world, and units of its own.\n\n",
        0.25 * keyframes as f64
    );
    text += "| | time | peak memory | maps read | map written | pairs looked at | that show a place alike | of these merged | merged wrongly | agents in one map |\n\
             |---|---|---|---|---|---|---|---|---|---|\n";
    for (name, merge) in
        [("all from nothing", &measured.all), ("one more, to that common map", &measured.one_more)]
    {
        let (pairs, [read, written]) = (&merge.pairs, merge.bytes.map(|bytes| bytes as f64 / 1e6));
        let _ = writeln!(
            text,
            "| {name} | {:.1} s | {:.0} MB | {read:.0} MB | {written:.0} MB | {} | {} | {} | {} | {} |",
            merge.seconds,
            merge.memory / 1e6,
            pairs.all,
            pairs.related,
            pairs.found,
            pairs.wrong,
            merge.together
        );
    }
    text
}
