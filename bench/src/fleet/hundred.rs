//! A hundred agents that come to one station, one after the other: how long each waits for its place, and what it costs the
//! others that one of them stands still.

mod coming;
mod published;

use super::Plan;
use anyhow::Result;
use std::fmt::Write;

/// How many come, with how many keyframes each.
const AGENTS: usize = 100;
const KEYFRAMES: usize = 8;
/// The one that stands still where one does.
const STALLED: usize = AGENTS / 2;
const HEAD: &str = "\n*A hundred agents*, each with 8 keyframes of 320 × 240 pixels of a rendered town and half a metre from the next, tell one \
    station their maps, one a second, each a process of its own (`loopbox fleet`). Seconds until an agent's place is told (p50, p90, p99, \
    longest): from the start of its program, from the station hearing of it, and from the parts of its map being there that say its place; \
    the last two from the look before, at which they were not there yet. *One stalled*: one stands still (`SIGSTOP`) with half of its map told, and is \
    not among those that are counted.\n\n\
    | | from its start | from being heard of | from its parts | all in one frame after | peak memory | CPU time | load before, after |\n\
    |---|---|---|---|---|---|---|---|\n";

/// Has them come, and says how long they waited as a table.
///
/// # Errors
/// When a program cannot be started or an agent gets no place.
pub fn measure(plan: &Plan) -> Result<String> {
    if !plan.only.is_empty() {
        return Ok(String::new());
    }
    let maps = published::maps(plan)?;
    let mut text = String::from(HEAD);
    for _ in 0..plan.runs {
        for (name, stalled) in [("all go on", None), ("one stalled", Some(STALLED))] {
            let line = coming::come(plan, &maps, stalled)?.line(name);
            eprint!("{line}");
            text += &line;
        }
    }
    Ok(text)
}

/// p50, p90, p99 and the longest: of each the least that so many do not exceed.
fn shares(waits: &[f64]) -> String {
    let mut waits = waits.to_vec();
    waits.sort_by(f64::total_cmp);
    let mut text = String::new();
    for share in [0.5, 0.9, 0.99, 1.0] {
        let at = ((share * waits.len() as f64).ceil() as usize).saturating_sub(1);
        let separator = if text.is_empty() { "" } else { ", " };
        let _ = write!(text, "{separator}{:.2}", waits.get(at).copied().unwrap_or(f64::NAN));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_the_least_that_so_many_do_not_exceed() {
        let waits: Vec<f64> = (1..=200).rev().map(f64::from).collect();
        assert_eq!(shares(&waits), "100.00, 180.00, 198.00, 200.00");
        assert_eq!(shares(&[2.0]), "2.00, 2.00, 2.00, 2.00");
        assert_eq!(shares(&[]), "NaN, NaN, NaN, NaN");
    }
}
