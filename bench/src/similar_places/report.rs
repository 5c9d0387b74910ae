//! What is said of maps of places that look alike.

use super::maps::name;
use super::outcome::{Line, Outcome};
use super::{Measured, PASSES};
use std::fmt::Write;

/// Counts of some pairs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Counts {
    /// Pairs of different places.
    strangers: usize,
    /// Of these, those of which a closure was judged.
    hard: usize,
    /// Of these, those left undecided.
    undecided: usize,
    /// Pairs merged wrongly, of different places or of one.
    wrong: usize,
    /// Pairs that show a place alike.
    related: usize,
    /// Of these, those merged rightly.
    right: usize,
}

impl Counts {
    fn of<'a>(pairs: impl Iterator<Item = &'a Outcome>) -> Self {
        let mut counts = Self::default();
        for pair in pairs {
            counts.strangers += usize::from(!pair.one_place);
            counts.hard += usize::from(!pair.one_place && pair.hard());
            counts.undecided += usize::from(!pair.one_place && pair.verdict == "undecided");
            counts.wrong += usize::from(pair.wrong());
            counts.related += usize::from(pair.related);
            counts.right += usize::from(pair.related && pair.accepted() && pair.right);
        }
        counts
    }

    fn row(&self) -> String {
        let Self { strangers, hard, undecided, wrong, related, right } = self;
        format!("{strangers} | {hard} | {undecided} | {wrong} | {right} of {related}")
    }
}

/// How many pairs were merged wrongly.
pub fn wrong(measured: &[Measured]) -> usize {
    Counts::of(measured.iter().flat_map(|measured| &measured.pairs)).wrong
}

/// What to tell while more is measured.
pub fn line(measured: &Measured) -> String {
    let counts = Counts::of(measured.pairs.iter());
    format!("{}: strangers, hard, undecided, wrong, right: {}", name(measured.kind), counts.row())
}

/// The section of the document.
pub fn section(measured: &[Measured], seed: u64) -> String {
    let mut text = format!(
        "Seed {seed}, {PASSES} ways past each place. *Hard*: a closure came as far as the verdict. *Wrong*: merged, and of different \
         places or not where the truth has it.\n\n\
         | places | pairs of different places | hard | left undecided | merged wrongly | of one place, merged right |\n\
         |---|---|---|---|---|---|\n"
    );
    for measured in measured {
        let _ = writeln!(text, "| {} | {} |", name(measured.kind), Counts::of(measured.pairs.iter()).row());
    }
    let all = || measured.iter().flat_map(|measured| &measured.pairs);
    let _ = writeln!(text, "| all | {} |", Counts::of(all()).row());
    let unmapped: usize = measured.iter().map(|measured| measured.unmapped).sum();
    let [turned, other] = [0, 1].map(|i| measured.iter().map(|measured| measured.turned[i]).sum::<usize>());
    let _ = write!(
        text,
        "\n{unmapped} recordings gave no map. Of {turned} pairs given in the other order {other} had another verdict.\n\n"
    );
    text + &curves(&all().collect::<Vec<_>>())
}

/// Of each line: how many pairs pass as its limit moves, the other lines as they are.
fn curves(pairs: &[&Outcome]) -> String {
    let mut names: Vec<(String, f64)> = Vec::new();
    for line in pairs.iter().flat_map(|pair| &pair.closures).flatten() {
        if !names.iter().any(|(name, _)| *name == line.name) {
            names.push((line.name.clone(), line.limit));
        }
    }
    let mut text = String::from(
        "Each line of the verdict alone, the others as they are: pairs of one place that pass · pairs of different ones, at so \
         much of the limit; the last column is without the line. *Alone*: closures of different places that this line and no \
         other keeps out.\n\n| line | limit | 0.5 × | 0.75 × | 1 × | 1.25 × | 1.5 × | without | alone |\n|---|---|---|---|---|---|---|---|---|\n",
    );
    for (name, limit) in names {
        let factors = [Some(0.5), Some(0.75), Some(1.0), Some(1.25), Some(1.5), None];
        let cells: Vec<String> = factors.map(|factor| cell(pairs, &name, factor)).into();
        let alone = pairs.iter().filter(|pair| !pair.one_place && passes(pair, &name, None)).count();
        let _ = writeln!(text, "| {name} | {limit} | {} | {alone} |", cells.join(" | "));
    }
    text.trim_end().to_owned()
}

/// Pairs of one place and of different ones that pass with so much of a line's limit, without it for nothing.
fn cell(pairs: &[&Outcome], name: &str, factor: Option<f64>) -> String {
    let count = |one_place: bool| {
        let asked = |pair: &&&Outcome| if one_place { pair.related } else { !pair.one_place };
        pairs.iter().filter(asked).filter(|pair| passes(pair, name, factor)).count()
    };
    format!("{} · {}", count(true), count(false))
}

/// Whether a closure of a pair passes all lines where the limit of one is other.
fn passes(pair: &Outcome, name: &str, factor: Option<f64>) -> bool {
    let holds = |line: &Line| match factor {
        _ if line.name != name => line.passes,
        None => true,
        // Which way a line asks is not written; at its limit it is known.
        Some(factor) => {
            let at_most = (line.value <= line.limit) == line.passes;
            let limit = line.limit * factor;
            if at_most { line.value <= limit } else { line.value >= limit }
        }
    };
    pair.closures.iter().any(|lines| lines.iter().all(holds))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pair of one place or of two with one closure, of lines with limit 1 that ask for at most so much.
    fn pair(one_place: bool, values: [f64; 2]) -> Outcome {
        let line = |(name, value): (&str, f64)| Line {
            name: name.to_owned(),
            value,
            limit: 1.0,
            passes: value <= 1.0,
        };
        let lines: Vec<Line> = ["a", "b"].into_iter().zip(values).map(line).collect();
        let accepted = lines.iter().all(|line| line.passes);
        Outcome {
            maps: [(0, 0), (u64::from(!one_place), 1)],
            related: one_place,
            one_place,
            verdict: if accepted { "accepted" } else { "refused" }.to_owned(),
            right: one_place,
            closures: vec![lines],
        }
    }

    #[test]
    fn a_limit_moved_lets_others_pass() {
        let pairs = [pair(true, [0.6, 0.2]), pair(false, [1.2, 0.5]), pair(false, [1.2, 3.0])];
        let pairs: Vec<&Outcome> = pairs.iter().collect();
        assert_eq!(cell(&pairs, "a", Some(1.0)), "1 · 0");
        assert_eq!(cell(&pairs, "a", Some(1.25)), "1 · 1");
        assert_eq!(cell(&pairs, "a", Some(0.5)), "0 · 0");
        assert_eq!(cell(&pairs, "a", None), "1 · 1");
        assert!(curves(&pairs).contains("| a | 1 | 0 · 0 | 1 · 0 | 1 · 0 | 1 · 1 | 1 · 1 | 1 · 1 | 1 |"));
    }

    #[test]
    fn a_wrong_merge_is_counted() {
        let pairs = [pair(true, [0.1, 0.1]), pair(false, [0.1, 0.1]), pair(false, [2.0, 0.1])];
        let counts = Counts::of(pairs.iter());
        assert_eq!((counts.strangers, counts.hard, counts.wrong), (2, 2, 1));
        assert_eq!((counts.related, counts.right), (1, 1));
    }
}
