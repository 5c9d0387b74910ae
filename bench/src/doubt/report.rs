//! What is reported of runs on which a tracker may be sure of itself and wrong.

use super::Outcome;
use super::judge::Fragment;
use crate::report::MISSING;
use std::fmt::Write;

/// One line for the terminal.
pub fn line(outcome: &Outcome) -> String {
    let fragment = |f: &Fragment| {
        let wrong = if f.is_wrong() { " WRONG" } else { "" };
        let number = |n: Option<f64>, digits| n.map_or(MISSING.to_owned(), |n| format!("{n:.digits$}"));
        let off = number(f.off.map(|off| 100.0 * off), 1);
        format!("{:?} off {off} % scales {}{wrong}", f.frames, number(f.scales, 2))
    };
    let fragments: Vec<String> = outcome.fragments.iter().map(fragment).collect();
    let reported = if outcome.is_reported { "reported" } else { "nothing reported" };
    format!("{:?} {}: {reported}; {}", outcome.kind, outcome.seed, fragments.join("; "))
}

/// The table of the results page: a row for each thing that happens.
pub fn section(outcomes: &[Outcome], seeds: &[u64]) -> String {
    let mut rows: Vec<String> = Vec::new();
    for outcome in outcomes {
        let row = outcome.kind.row();
        if !rows.contains(&row) {
            rows.push(row);
        }
    }
    let seeds: Vec<String> = seeds.iter().map(u64::to_string).collect();
    let mut text = format!(
        "Seeds {}. *Wrong*: a fragment of half a second or more is off by 5 % of its path, or the scales of two stretches of three seconds in it \
         differ by half, or it holds frames of two places. *Together*: frames of the place in the fragment with most of them.\n\n\
         | what happens | recordings | frames with a pose | together | wrong, nothing reported | wrong, after a loss or a doubt | largest change of \
         scale | most off, of the path |\n|---|---|---|---|---|---|---|---|\n",
        seeds.join(", ")
    );
    for row in &rows {
        let own: Vec<&Outcome> = outcomes.iter().filter(|outcome| outcome.kind.row() == *row).collect();
        let _ = writeln!(text, "| {row} {}", cells(&own));
    }
    let all: Vec<&Outcome> = outcomes.iter().collect();
    let _ = writeln!(text, "| **all** {}", cells(&all));
    text
}

fn cells(own: &[&Outcome]) -> String {
    let fragments = || own.iter().flat_map(|outcome| &outcome.fragments);
    let visible: usize = own.iter().map(|outcome| outcome.visible).sum();
    let posed: usize = fragments().map(|f| f.frames[0] + f.frames[1]).sum();
    let most = |outcome: &&Outcome| outcome.fragments.iter().map(|f| f.frames[0] + f.frames[1]).max();
    let together: usize = own.iter().filter_map(most).sum();
    let wrong = |is_reported: bool| {
        let is_wrong = |outcome: &&&Outcome| {
            outcome.is_reported == is_reported && outcome.fragments.iter().any(Fragment::is_wrong)
        };
        own.iter().filter(is_wrong).count()
    };
    let percent = |part: usize| format!("{:.1} %", 100.0 * part as f64 / visible.max(1) as f64);
    let largest = |of: &dyn Fn(&Fragment) -> Option<f64>| fragments().filter_map(of).reduce(f64::max);
    let scales = largest(&|f| f.scales).map_or(MISSING.to_owned(), |ratio| format!("{ratio:.2}"));
    let off = largest(&|f| f.off).map_or(MISSING.to_owned(), |off| format!("{:.1} %", 100.0 * off));
    let (reported, silent) = (wrong(true), wrong(false));
    format!(
        "| {} | {} | {} | {silent} | {reported} | {scales} | {off} |",
        own.len(),
        percent(posed),
        percent(together)
    )
}

#[cfg(test)]
mod tests {
    use super::super::cases::Kind;
    use super::*;

    #[test]
    fn a_row_counts_what_is_wrong_and_whether_it_was_reported() {
        let right = Fragment { frames: [80, 0], off: Some(0.01), scales: Some(1.1), ..Fragment::default() };
        let wrong = Fragment { frames: [10, 10], joins_places: true, ..Fragment::default() };
        let outcome = |is_reported, fragments| Outcome {
            kind: Kind::TurnsFirst,
            seed: 1,
            visible: 100,
            fragments,
            is_reported,
        };
        let outcomes =
            [outcome(false, vec![right]), outcome(true, vec![right, wrong]), outcome(false, vec![wrong])];
        let text = section(&outcomes, &[1]);
        let row = "| a camera turns for 4 s before it moves | 3 | 66.7 % | 60.0 % | 1 | 1 | 1.10 | 1.0 % |";
        assert!(text.contains(row), "{text}");
    }
}
