//! What is said of places and their doubles.

use super::{Became, DIFFERING, GRAINS, KEYFRAMES, NOISE, Pair, Relation, moved, name_of};
use loopbox_tests::doubles::Kind;
use std::fmt::Write;

/// How many pairs were merged wrongly, of those in which something that differs is in view.
pub fn wrong(pairs: &[Pair]) -> usize {
    pairs.iter().filter(|pair| pair.became == Became::Wrong && !pair.has_same_images).count()
}

/// The section of the document: of each kind and grain, what was merged by the share that differs.
pub fn section(pairs: &[Pair], seed: u64, days_apart: f64) -> String {
    let moved = moved(days_apart).iter().copied();
    let columns: Vec<Relation> =
        DIFFERING.into_iter().map(Relation::Double).chain(moved.map(Relation::Same)).collect();
    let apart = if days_apart > 0.0 { format!(" (`--days-apart {days_apart}`)") } else { String::new() };
    let mut text = format!(
        "Seed {seed}, exact maps of {KEYFRAMES} keyframes, image noise of {NOISE} grey levels, each pair by itself{apart}. *Two*: two places, of which \
         such a share of the things differs, merged (wrongly) of so many; *alike* those whose images are the place's own to the bit, as nothing \
         that differs is in view. *One*: one place, of which such a share of the things was moved, \
         merged rightly of so many; what is not merged is undecided, or behind a slash refused. *Grain*: what each surface has of its \
         own, grey levels. **Bold**: kinds on which no limit was set.\n\n| places | grain |"
    );
    for column in &columns {
        let _ = match column {
            Relation::Double(share) => write!(text, " two, {:.0} % |", 100.0 * share),
            Relation::Same(moved) => write!(text, " one, {:.0} % |", 100.0 * moved),
        };
    }
    let _ = writeln!(text, "\n|---|---|{}", "---|".repeat(columns.len()));
    let of_kind = |kind: Kind| move |pair: &&Pair| pair.kind == kind;
    for (kind, is_held_out) in kinds().filter(|(kind, _)| pairs.iter().any(|pair| pair.kind == *kind)) {
        for grain in GRAINS {
            let own: Vec<&Pair> = pairs.iter().filter(of_kind(kind)).filter(|p| p.grain == grain).collect();
            if own.is_empty() {
                continue;
            }
            let name = if is_held_out { format!("**{}**", name_of(kind)) } else { name_of(kind) };
            row(&mut text, &name, &grain.to_string(), &columns, &own);
        }
    }
    for (name, is_held_out) in [("all", false), ("**all**", true)] {
        let of = |kind: Kind| kinds().any(|(other, held_out)| other == kind && held_out == is_held_out);
        let own: Vec<&Pair> = pairs.iter().filter(|pair| of(pair.kind)).collect();
        row(&mut text, name, "", &columns, &own);
    }
    let alike: Vec<&Pair> = pairs.iter().filter(|pair| pair.has_same_images).collect();
    let merged = alike.iter().filter(|pair| pair.became == Became::Wrong).count();
    let _ = writeln!(
        text,
        "\nMerged wrongly: {} of {} pairs, and {merged} of {} doubles that are alike.",
        wrong(pairs),
        pairs.len() - alike.len(),
        alike.len()
    );
    text
}

/// All kinds, and whether they are shown only.
fn kinds() -> impl Iterator<Item = (Kind, bool)> {
    Kind::TUNED
        .into_iter()
        .map(|kind| (kind, false))
        .chain(Kind::HELD_OUT.into_iter().map(|kind| (kind, true)))
}

fn row(text: &mut String, name: &str, grain: &str, columns: &[Relation], pairs: &[&Pair]) {
    let _ = write!(text, "| {name} | {grain} |");
    for column in columns {
        let of = |has_same_images: bool| {
            let own = pairs
                .iter()
                .filter(move |pair| pair.relation == *column && pair.has_same_images == has_same_images);
            own.map(|pair| pair.became).collect::<Vec<_>>()
        };
        let (became, alike) = (of(false), of(true));
        let count = |of: Became| became.iter().filter(|became| **became == of).count();
        let _ = match column {
            Relation::Double(_) => {
                let merged = alike.iter().filter(|became| **became == Became::Wrong).count();
                let alike = match alike.len() {
                    0 => String::new(),
                    all => format!(", alike {merged} of {all}"),
                };
                write!(text, " {} of {}{alike} |", count(Became::Wrong), became.len())
            }
            Relation::Same(_) => {
                let apart = count(Became::Apart) + count(Became::Wrong);
                let apart = if apart > 0 { format!(" / {apart}") } else { String::new() };
                write!(text, " {} of {}{apart} |", count(Became::Right), became.len())
            }
        };
    }
    text.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_counts_by_the_share_that_differs() {
        let pair = |relation, became| Pair {
            kind: Kind::Lobby,
            grain: 3.0,
            relation,
            has_same_images: false,
            became,
        };
        let pairs = [
            pair(Relation::Double(0.05), Became::Wrong),
            pair(Relation::Double(0.05), Became::Undecided),
            pair(Relation::Double(1.0), Became::Apart),
            Pair { has_same_images: true, ..pair(Relation::Double(0.05), Became::Wrong) },
            pair(Relation::Same(0.0), Became::Right),
            pair(Relation::Same(0.2), Became::Undecided),
            pair(Relation::Same(0.2), Became::Apart),
        ];
        let text = section(&pairs, 7, 0.0);
        let row = "| **lobby** | 3 | 1 of 2, alike 1 of 1 | 0 of 0 | 0 of 0 | 0 of 1 | 1 of 1 | 0 of 0 | 0 of 2 / 1 |";
        assert!(text.contains(row), "{text}");
        assert!(text.contains("Merged wrongly: 1 of 6 pairs, and 1 of 1 doubles that are alike."), "{text}");
        assert_eq!(wrong(&pairs), 1);
    }
}
