//! Tables of what merges gave.

use super::cases::{Case, Common, Measured, Numbers};
use super::judge::{ENOUGH, ScoredPair, Verdict};
use super::truth::{OFFSET, ROTATION, SCALE};
use super::{Merging, OWN};
use crate::report::{MISSING, length, number};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Seconds that a merge may take.
const SECONDS: f64 = 0.5;
/// The most that a merge may change with the units and worlds of its maps, parts.
const CHANGE: f64 = 1e-3;

/// One line for the terminal.
pub fn line(measured: &Measured) -> String {
    let case = &measured.case;
    match &measured.result {
        Ok(n) => {
            format!("{:<20} {}  {}  {}", case.name, length(n.error), scale(n), number(n.seconds, 2, " s"))
        }
        Err(reason) => format!("{:<20} FAILED: {reason}", case.name),
    }
}

/// Errors and times of the cases.
pub fn cases(merging: &Merging, runs: usize) -> String {
    let mut out = "Error is the ATE RMSE of the other agents after the first one alone was aligned with the truth; of \
                   several, the largest. *Scale* is by how much another agent's unit differs from the first one's. \
                   *Shared* is the length of path nearer than 1 m to the other's, by the true poses.\n\n"
        .to_owned();
    out.push_str("| maps | | shared | error | to reach | scale | to reach | reached |\n");
    out.push_str("|---|---|---|---|---|---|---|---|\n");
    for measured in &merging.cases {
        let case = &measured.case;
        let reach_percent = case.reach_percent.map_or(MISSING.to_owned(), |percent| format!("≤ {percent} %"));
        let (error, scale, reached) = match &measured.result {
            Ok(n) => (length(n.error), scale(n), if n.reaches(case) { "yes" } else { "**no**" }),
            Err(_) => (MISSING.to_owned(), MISSING.to_owned(), "**no**"),
        };
        let (title, shared, reach) = (case.title(), shared(&measured.common), length(case.reach));
        let cells =
            [&title, case.what, &shared, &error, &format!("≤ {reach}"), &scale, &reach_percent, reached];
        let _ = writeln!(out, "| {} |", cells.join(" | "));
    }
    out.push('\n');
    for measured in &merging.cases {
        if let Err(reason) = &measured.result {
            let _ = writeln!(out, "{} failed: {reason}\n", measured.case.title());
        }
        if let [_, outer, _] = measured.common[..] {
            let _ = writeln!(
                out,
                "In {} the outer two share no more than {:.0} % of a view.\n",
                measured.case.title(),
                100.0 * outer.overlap
            );
        }
    }
    out.push_str(&costs(&merging.cases, runs));
    out.push_str(&changes(merging));
    out
}

/// What each pair of recordings in a row of them shares.
fn shared(common: &[Common]) -> String {
    let metres: Vec<String> = match common {
        // In a chain the first and the last are strangers.
        [first, _, last] => [first, last].map(|common| format!("{:.1} m", common.metres)).into(),
        all => all.iter().map(|common| format!("{:.1} m", common.metres)).collect(),
    };
    metres.join(", ")
}

fn scale(numbers: &Numbers) -> String {
    number(numbers.scale_percent, 2, " %")
}

/// Time and memory.
fn costs(cases: &[Measured], runs: usize) -> String {
    let mut out = format!(
        "Time of a merge is that of place recognition, closures and the common map: without reading and writing files, \
         and without reading the features of the keyframes, which maps keep: the time a keyframe stands beside it. To reach: {SECONDS} s. The first \
         two are medians of {runs}.\n\n| maps | merge | features a keyframe | peak memory |\n|---|---|---|---|\n"
    );
    for measured in cases {
        if let Ok(n) = &measured.result {
            let memory = number(n.memory.map(|bytes| bytes / 1e6), 0, " MB");
            let (seconds, features) = (number(n.seconds, 2, " s"), number(n.features_ms, 0, " ms"));
            let _ = writeln!(out, "| {} | {seconds} | {features} | {memory} |", measured.case.title());
        }
    }
    out.push('\n');
    out
}

/// What other units and worlds changed.
fn changes(merging: &Merging) -> String {
    if merging.changes.is_empty() {
        return String::new();
    }
    let mut out = format!(
        "The maps moved anywhere and in other units give the same merge: the largest distance of a pose from where it \
         was, after one alignment of all, in parts of the trajectories' extent. To reach: {CHANGE}.\n\n\
         | maps | change |\n|---|---|\n"
    );
    for change in &merging.changes {
        let largest = match &change.largest {
            Ok(largest) if *largest <= CHANGE => format!("{largest:.1e}"),
            Ok(largest) => format!("**{largest:.1e}**"),
            Err(reason) => format!("**{reason}**"),
        };
        let _ = writeln!(out, "| {} | {largest} |", change.what);
    }
    out.push('\n');
    out
}

/// The methods beside each other, as in Table I of the paper.
pub fn methods(merging: &Merging) -> String {
    if merging.compared.is_empty() {
        return "The program has no methods to choose from.".to_owned();
    }
    let mut out = "Error, as above, and seconds of the merge.\n\n| maps |".to_owned();
    merging.methods.iter().for_each(|method| _ = write!(out, " `{method}` |"));
    let _ = writeln!(out, "\n|---|{}", "---|".repeat(merging.methods.len()));
    for (case, results) in &merging.compared {
        let _ = write!(out, "| {} |", case.title());
        for result in results {
            let cell = match result {
                Ok(n) => format!("{} · {}", length(n.error), number(n.seconds, 2, " s")),
                Err(_) => MISSING.to_owned(),
            };
            let _ = write!(out, " {cell} |");
        }
        out.push('\n');
    }
    out.push('\n');
    out.push_str(&winners(merging));
    for (case, results) in &merging.compared {
        for (method, result) in merging.methods.iter().zip(results) {
            if let Err(reason) = result {
                let _ = writeln!(out, "`{method}` did not merge {}: {reason}\n", case.title());
            }
        }
    }
    out
}

/// Where `direct` is not the most accurate, and where not the fastest.
fn winners(merging: &Merging) -> String {
    let Some(own) = merging.methods.iter().position(|method| *method == OWN) else { return String::new() };
    let least = |value: &dyn Fn(&Numbers) -> Option<f64>| -> Vec<String> {
        let lost = |(case, results): &(Case, Vec<Result<Numbers, String>>)| {
            let of = |result: &Result<Numbers, String>| {
                result.as_ref().ok().and_then(value).unwrap_or(f64::INFINITY)
            };
            let ours = of(&results[own]);
            let better = merging.methods.iter().zip(results).filter(|(_, result)| of(result) < ours);
            let names: Vec<String> = better.map(|(method, _)| format!("`{method}`")).collect();
            (!names.is_empty()).then(|| format!("{} ({})", case.title(), names.join(", ")))
        };
        merging.compared.iter().filter_map(lost).collect()
    };
    let say = |what: &str, lost: Vec<String>| match &lost[..] {
        [] => format!("No other method is {what} than `{OWN}` in any of them.\n\n"),
        lost => format!("Others are {what} than `{OWN}` in: {}.\n\n", lost.join("; ")),
    };
    say("more accurate", least(&|n| Some(n.error))) + &say("faster", least(&|n| n.seconds))
}

/// What was merged and refused.
pub fn refusals(merging: &Merging) -> String {
    let mut out = format!(
        "A merge is right when, between the keyframes where the agents met, the rotation is within {ROTATION}° of the \
         truth, the offset within {:.0} % of the scene's depth, and the scale within {:.0} %. Maps *show a place \
         alike* when two keyframes have at least 25 % of their points in each other's image by the true poses, and are \
         *strangers* below 5 %. *Missed* are those refused that show a place alike and share {ENOUGH} m of path or \
         more.\n\n",
        100.0 * OFFSET,
        100.0 * SCALE
    );
    out.push_str("| pairs | merged right | merged wrong | strangers refused | missed | others refused |\n");
    out.push_str("|---|---|---|---|---|---|\n");
    let groups = [
        ("all sequences", &merging.pairs),
        ("both ends of a sequence that share no view", &merging.ends),
        ("random parts of maps, 10–40 keyframes each", &merging.cuts),
    ];
    for (name, pairs) in groups {
        let _ = writeln!(out, "| {} {name} | {} |", pairs.len(), counts(pairs).join(" | "));
    }
    out.push_str(&recall(&merging.cuts));
    let misses: Vec<&ScoredPair> =
        groups.iter().flat_map(|(_, pairs)| pairs.iter()).filter(|scored| scored.is_missed()).collect();
    for (title, list) in [("Wrong", merging.wrong().collect()), ("Missed", misses)] {
        if !list.is_empty() {
            let _ = writeln!(out, "\n{title}:\n");
            list.into_iter().for_each(|scored| out.push_str(&item(scored)));
        }
    }
    out.push_str("\n| reason of a refusal | strangers | others |\n|---|---|---|\n");
    let all = merging.pairs.iter().chain(&merging.ends).chain(&merging.cuts);
    for (reason, [strangers, others]) in histogram(all) {
        let _ = writeln!(out, "| {reason} | {strangers} | {others} |");
    }
    out
}

/// How many of the pairs that share a view and so much path were merged rightly.
fn recall(pairs: &[ScoredPair]) -> String {
    let shared = [0.0, 0.5, 1.0, ENOUGH].map(|metres| {
        let related = || pairs.iter().filter(|scored| scored.is_related() && scored.common.metres >= metres);
        let right = related().filter(|scored| matches!(scored.verdict, Verdict::Right(_))).count();
        let all = related().count();
        format!("{right} of {all} with {metres} m of path or more")
    });
    format!("\nOf the random parts that show a place alike were merged {}.\n", shared.join(", "))
}

/// Counts of the columns of the table of refusals.
fn counts(pairs: &[ScoredPair]) -> [String; 5] {
    let count = |is: &dyn Fn(&ScoredPair) -> bool| pairs.iter().filter(|scored| is(scored)).count();
    let refused = |scored: &ScoredPair| matches!(scored.verdict, Verdict::Refused(_));
    let wrong = count(&|scored| matches!(scored.verdict, Verdict::Wrong(_)));
    [
        count(&|scored| matches!(scored.verdict, Verdict::Right(_))).to_string(),
        if wrong == 0 { "0".to_owned() } else { format!("**{wrong}**") },
        count(&|scored| refused(scored) && scored.are_strangers()).to_string(),
        count(&|scored| scored.is_missed()).to_string(),
        count(&|scored| refused(scored) && !scored.are_strangers() && !scored.is_missed()).to_string(),
    ]
}

/// A line about a pair.
fn item(scored: &ScoredPair) -> String {
    let verdict = match &scored.verdict {
        Verdict::Right(d) | Verdict::Wrong(d) => format!(
            "turned by {:.1}°, off by {:.1} % of the depth, scale {:+.1} %",
            d.rotation,
            100.0 * d.offset,
            100.0 * d.scale
        ),
        Verdict::Refused(reason) => reason.clone(),
    };
    let (overlap, metres) = (100.0 * scored.common.overlap, scored.common.metres);
    format!("- {}: share {metres:.1} m and {overlap:.0} % of a view; {verdict}\n", scored.name)
}

/// How often a reason, its numbers left out, refused strangers and others; the most frequent first.
fn histogram<'a>(pairs: impl Iterator<Item = &'a ScoredPair>) -> Vec<(String, [usize; 2])> {
    let mut counts: BTreeMap<String, [usize; 2]> = BTreeMap::new();
    for scored in pairs {
        if let Verdict::Refused(reason) = &scored.verdict {
            counts.entry(without_numbers(reason)).or_default()[usize::from(!scored.are_strangers())] += 1;
        }
    }
    let mut counts: Vec<_> = counts.into_iter().collect();
    counts.sort_by_key(|(_, [strangers, others])| std::cmp::Reverse(strangers + others));
    counts
}

/// A text with `…` for every number in it.
fn without_numbers(text: &str) -> String {
    let word = |word: &str| match word.find(|c: char| c.is_ascii_digit()) {
        Some(first) => {
            let end = word.rfind(|c: char| c.is_ascii_digit()).map_or(word.len(), |last| last + 1);
            format!("{}…{}", &word[..first], &word[end..])
        }
        None => word.to_owned(),
    };
    text.split(' ').map(word).collect::<Vec<_>>().join(" ")
}

/// The short table of the book's benchmarks.
pub fn summary(merging: &Merging) -> String {
    let mut out = "| merging | error of the other agents | scale | time |\n|---|---|---|---|\n".to_owned();
    for measured in
        merging.cases.iter().filter(|measured| measured.case.compared || measured.common.len() > 1)
    {
        let cells = match &measured.result {
            Ok(n) => [length(n.error), scale(n), number(n.seconds, 2, " s")],
            Err(_) => [MISSING; 3].map(str::to_owned),
        };
        let (title, what) = (measured.case.title(), measured.case.what);
        let _ = writeln!(out, "| {title}, {what} | {} |", cells.join(" | "));
    }
    let pairs = merging.pairs.len() + merging.ends.len() + merging.cuts.len();
    let all = merging.pairs.iter().chain(&merging.ends).chain(&merging.cuts);
    let related: Vec<&ScoredPair> = all.filter(|scored| scored.is_related()).collect();
    let right = related.iter().filter(|scored| matches!(scored.verdict, Verdict::Right(_))).count();
    let _ = writeln!(
        out,
        "\nOf {pairs} pairs of maps and of parts of maps {} were merged wrongly; of the {} that share a quarter of a \
         view or more {right} were merged.",
        merging.wrong().count(),
        related.len()
    );
    out
}

#[cfg(test)]
mod tests {
    use super::super::cases::CASES;
    use super::super::truth::Deviation;
    use super::*;

    fn numbers(error: f64, seconds: f64) -> Numbers {
        let scale_percent = Some(0.1);
        Numbers { error, scale_percent, seconds: Some(seconds), features_ms: None, memory: None }
    }

    fn scored(overlap: f64, metres: f64, verdict: Verdict) -> ScoredPair {
        ScoredPair { name: "a + b".to_owned(), common: Common { overlap, metres }, verdict }
    }

    fn merging() -> Merging {
        let refused = |reason: &str| Verdict::Refused(reason.to_owned());
        let wrong = Verdict::Wrong(Deviation { rotation: 9.0, offset: 0.1, scale: -0.2 });
        let right = Verdict::Right(Deviation { rotation: 0.1, offset: 0.01, scale: 0.0 });
        Merging {
            cases: vec![Measured {
                case: CASES[0],
                common: vec![Common { overlap: 0.8, metres: 12.6 }],
                result: Ok(numbers(0.026, 0.4)),
            }],
            methods: vec!["pgo-full", "direct"],
            compared: vec![
                (CASES[0], vec![Ok(numbers(0.05, 0.1)), Ok(numbers(0.026, 0.4))]),
                (CASES[1], vec![Err("refused: far".to_owned()), Ok(numbers(0.01, 0.4))]),
            ],
            changes: Vec::new(),
            pairs: vec![scored(0.0, 0.0, refused("2 matches are too few: at least 16 are needed"))],
            ends: vec![scored(0.0, 0.0, refused("11 matches are too few: at least 16 are needed"))],
            cuts: vec![
                scored(0.9, 3.0, refused("no place of one looks like a place of the other")),
                scored(0.9, 0.5, refused("0.12 of the view is shared")),
                scored(0.9, 5.0, right),
                scored(0.9, 5.0, wrong),
            ],
        }
    }

    #[test]
    fn refusals_are_counted_by_what_is_shared() {
        let text = refusals(&merging());
        assert!(
            text.contains("| 4 random parts of maps, 10–40 keyframes each | 1 | **1** | 0 | 1 | 1 |"),
            "{text}"
        );
        assert!(text.contains("| 1 all sequences | 0 | 0 | 1 | 0 | 0 |"), "{text}");
        assert!(text.contains("| … matches are too few: at least … are needed | 2 | 0 |"), "{text}");
        assert!(
            text.contains("Wrong:\n\n- a + b: share 5.0 m and 90 % of a view; turned by 9.0°, off by 10.0 %")
        );
    }

    #[test]
    fn the_winner_is_named() {
        let text = methods(&merging());
        assert!(text.contains("No other method is more accurate than `direct`"), "{text}");
        assert!(text.contains("Others are faster than `direct` in: `parking_a` + `parking_b` (`pgo-full`)."));
        assert!(text.contains("`pgo-full` did not merge `parking_a` + `parking_c`: refused: far"));
    }

    #[test]
    fn numbers_are_left_out_of_reasons() {
        assert_eq!(without_numbers("0.12 of (3.5°) a-b"), "… of (…°) a-b");
    }

    #[test]
    fn cases_say_whether_they_are_reached() {
        let text = cases(&merging(), 3);
        let row = "| `parking_a` + `parking_b` | same direction | 12.6 m | 2.60 cm | ≤ 10.00 cm | 0.10 % | ≤ 0.3 % | yes |";
        assert!(text.contains(row), "{text}");
        assert!(
            summary(&merging())
                .contains("Of 6 pairs of maps and of parts of maps 1 were merged wrongly; of the ")
        );
    }
}
