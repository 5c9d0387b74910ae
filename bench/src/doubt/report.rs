//! What is reported of runs on which a tracker may be sure of itself and wrong.

use super::judge::{FoundLater, Fragment, TIMES};
use super::{Outcome, Returned};
use crate::report::MISSING;
use measuring::median;
use std::fmt::Write;

/// Metres within which frames that come back are found, where a drive is right: 0.4 % of the way.
const GAP: f64 = 1.0;

/// One line for the terminal.
pub fn line(outcome: &Outcome) -> String {
    let fragment = |f: &Fragment| {
        let wrong = if f.is_wrong() { " WRONG" } else { "" };
        let number = |n: Option<f64>, digits| n.map_or(MISSING.to_owned(), |n| format!("{n:.digits$}"));
        let off = number(f.off.map(|off| 100.0 * off), 1);
        format!("{:?} off {off} % scales {}{wrong}", f.frames, number(f.scales, 2))
    };
    let fragments: Vec<String> = outcome.fragments.iter().map(fragment).collect();
    let returned = outcome.returned.map_or(String::new(), |returned| {
        let gap = returned.gap.map_or(MISSING.to_owned(), |gap| format!("{gap:.2} m"));
        format!("; {} loops, gap {gap}", returned.loops)
    });
    let later = |later: &FoundLater| {
        let [metres, radians] = later.live;
        let live = format!("{:.2} cm, {:.3}°", 100.0 * metres, radians.to_degrees());
        let [position, direction] = later.most;
        format!(
            "; {} found later, {} off, by {position:.1} and {direction:.1} times {live}",
            later.frames, later.off
        )
    };
    let later: String = outcome.found_later.iter().map(later).collect();
    let reported = if outcome.is_reported { "reported" } else { "nothing reported" };
    format!("{:?} {}: {reported}; {}{returned}{later}", outcome.kind, outcome.seed, fragments.join("; "))
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
    text += &loops(outcomes);
    text += &found_later(outcomes);
    text
}

/// What outcomes have, by the row that they are counted in, in the order of the rows; those that have nothing are left out.
fn by_row<T>(outcomes: &[Outcome], of: impl Fn(&Outcome) -> Vec<T>) -> Vec<(String, Vec<T>)> {
    let mut rows: Vec<(String, Vec<T>)> = Vec::new();
    for outcome in outcomes {
        let (row, own) = (outcome.kind.row(), of(outcome));
        match rows.iter_mut().find(|(name, _)| *name == row) {
            _ if own.is_empty() => {}
            Some((_, all)) => all.extend(own),
            None => rows.push((row, own)),
        }
    }
    rows
}

/// The table of frames that were found later than they were seen; nothing where there is none.
fn found_later(outcomes: &[Outcome]) -> String {
    let rows = by_row(outcomes, |outcome| outcome.found_later.clone());
    if rows.is_empty() {
        return String::new();
    }
    let mut text = format!(
        "\nFrames that had no pose when they were seen and were found later, from before a map or before the camera was found again. *Off*: {TIMES} \
         times the RMS error of the fragment's live poses, in position or direction, after the similarity that fits these.\n\n\
         | what happens | fragments with such frames | frames | of these off | fragments with one that is off | live poses' RMS error: median | most of \
         these, times that: median | most of the found: median, largest |\n|---|---|---|---|---|---|---|---|\n"
    );
    for (row, own) in &rows {
        let of = |value: &dyn Fn(&FoundLater) -> f64| own.iter().map(value).collect::<Vec<f64>>();
        let number =
            |value: Option<f64>, digits| value.map_or(MISSING.to_owned(), |v| format!("{v:.digits$}"));
        let most = of(&|later| later.most[0].max(later.most[1]));
        let _ = writeln!(
            text,
            "| {row} | {} | {} | {} | {} | {} cm, {}° | {} | {}, {} |",
            own.len(),
            own.iter().map(|later| later.frames).sum::<usize>(),
            own.iter().map(|later| later.off).sum::<usize>(),
            own.iter().filter(|later| later.off > 0).count(),
            number(median(of(&|later| 100.0 * later.live[0])), 2),
            number(median(of(&|later| later.live[1].to_degrees())), 3),
            number(median(of(&|later| later.most_live[0].max(later.most_live[1]))), 1),
            number(median(most.clone()), 1),
            number(most.iter().copied().reduce(f64::max), 1)
        );
    }
    text
}

/// The table of drives that come back; nothing where there is none.
fn loops(outcomes: &[Outcome]) -> String {
    let rows = by_row(outcomes, |outcome| outcome.returned.into_iter().collect());
    if rows.is_empty() {
        return String::new();
    }
    let mut text = format!(
        "\nDrives that come back. *Right*: frames at the end are found within {GAP} m of where they are, from the nearest frame at the begin; \
         either their points are tracked again, or a loop is closed. *Wrongly*: a loop is closed, and they are not.\n\n\
         | drive | drives | right | of these by a loop | wrongly | gap: median, most |\n|---|---|---|---|---|---|\n"
    );
    for (row, own) in &rows {
        let count =
            |is_asked: &dyn Fn(&Returned) -> bool| own.iter().filter(|returned| is_asked(returned)).count();
        let is_near = |returned: &Returned| returned.gap.is_some_and(|gap| gap <= GAP);
        let gaps: Vec<f64> = own.iter().filter_map(|returned| returned.gap).collect();
        let most = gaps.iter().copied().reduce(f64::max);
        let metres = |gap: Option<f64>| gap.map_or(MISSING.to_owned(), |gap| format!("{gap:.2} m"));
        let _ = writeln!(
            text,
            "| {row} | {} | {} | {} | {} | {}, {} |",
            own.len(),
            count(&is_near),
            count(&|returned| returned.loops > 0 && is_near(returned)),
            count(&|returned| returned.loops > 0 && !is_near(returned)),
            metres(median(gaps)),
            metres(most)
        );
    }
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
    use loopbox_tests::streets::Return;

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
            returned: None,
            found_later: vec![FoundLater {
                frames: 9,
                off: 2,
                live: [0.01, 0.001],
                most_live: [2.0, 2.5],
                most: [4.0, 1.0],
            }],
        };
        let outcomes =
            [outcome(false, vec![right]), outcome(true, vec![right, wrong]), outcome(false, vec![wrong])];
        let text = section(&outcomes, &[1]);
        let row = "| a camera turns for 4 s before it moves | 3 | 66.7 % | 60.0 % | 1 | 1 | 1.10 | 1.0 % |";
        assert!(text.contains(row), "{text}");
        assert!(!text.contains("Drives that come back"));
        let row =
            "| a camera turns for 4 s before it moves | 3 | 27 | 6 | 3 | 1.00 cm, 0.057° | 2.5 | 4.0, 4.0 |";
        assert!(text.contains(row), "{text}");
    }

    #[test]
    fn a_drive_that_comes_back_is_right_by_a_loop_or_without_or_wrong() {
        let outcome = |loops, gap| Outcome {
            kind: Kind::Loop(Return::MetreAside),
            seed: 1,
            visible: 100,
            fragments: Vec::new(),
            is_reported: false,
            returned: Some(Returned { loops, gap }),
            found_later: Vec::new(),
        };
        let outcomes =
            [outcome(2, Some(0.1)), outcome(1, Some(7.0)), outcome(0, Some(0.4)), outcome(0, None)];
        let row = "| round a block, back a metre aside | 4 | 2 | 1 | 1 | 0.40 m, 7.00 m |";
        let text = section(&outcomes, &[1]);
        assert!(text.contains(row), "{text}");
    }
}
