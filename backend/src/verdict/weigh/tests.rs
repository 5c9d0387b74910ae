use super::*;

fn piece(kind: PieceKind, ln_agreement: f64) -> Piece {
    Piece { kind, share: 0.01, things: 1.0, occurrences: 1.0, ln_agreement }
}

/// So many things that look the same and so many that do not.
fn looks(similar: usize, other: usize) -> Vec<Piece> {
    let all = [vec![4.0; similar], vec![-4.0; other]].concat();
    all.into_iter().map(|l| piece(PieceKind::Look, l)).collect()
}

fn ln_ratio(pieces: &[Piece], days_apart: f64) -> f64 {
    weigh(pieces, &Prior { days_apart, ..Prior::default() }).ln_ratio
}

#[test]
fn nothing_seen_says_nothing() {
    let found = weigh(&[], &Prior::default());
    assert_eq!((found.ln_ratio, found.answer), (0.0, Answer::CannotTell));
    let no_number = piece(PieceKind::Look, f64::NAN);
    assert_eq!(weigh(&[no_number], &Prior::default()).ln_ratio, 0.0);
    assert!(ln_ratio(&[piece(PieceKind::Look, 0.0); 9], 0.0).abs() < 1e-9);
}

/// Certain pieces alone: `B(b + n − k, k + 1) b / B(n − k + 1, k + 1)` in closed form.
#[test]
fn the_ratio_is_that_of_the_integrals() {
    let pieces: Vec<Piece> = (0..30).map(|_| piece(PieceKind::Look, 40.0)).collect();
    let agree = Prior::default().changed().recip() - 1.0;
    let (one, any) = (agree / (agree + 30.0), 1.0 / 31.0);
    let expected = ((0.98 * one + 0.02 * any) / (0.2 * one + 0.8 * any)).ln();
    assert!((ln_ratio(&pieces, 0.0) - expected).abs() < 0.01);
    assert_eq!(super::ln_ratio(&pieces, &Prior::default()), ln_ratio(&pieces, 0.0));
    // Shapes are no copies.
    let shapes: Vec<Piece> = pieces.iter().map(|piece| Piece { kind: PieceKind::Shape, ..*piece }).collect();
    let expected = (0.98 * one / any + 0.02).ln();
    assert!((ln_ratio(&shapes, 0.0) - expected).abs() < 0.01);
}

/// More that differs is never judged more leniently, at any distance in time and by any share.
#[test]
fn the_ratio_falls_with_every_thing_that_differs() {
    for days in [0.0, 1.0, 30.0] {
        for n in [5usize, 40] {
            let ratios: Vec<f64> = (0..=n).map(|k| ln_ratio(&looks(n - k, k), days)).collect();
            assert!(ratios.windows(2).all(|pair| pair[1] <= pair[0] + 1e-9), "{n} {days}: {ratios:?}");
        }
    }
    let own = Prior { copied: 0.0, ..Prior::default() };
    let answer = |other: usize| weigh(&looks(100 - other, other), &own).answer;
    assert_eq!([0, 10, 90].map(answer), [Answer::Same, Answer::CannotTell, Answer::CannotTell]);
    let answer = |other: usize| weigh(&looks(100 - other, other), &Prior::default()).answer;
    assert_eq!([0, 10, 90].map(answer), [Answer::CannotTell; 3]);
}

/// However many agree, a hall of racks and its double with the same goods do: it takes what is nowhere else.
#[test]
fn looks_alone_tell_no_place_from_its_copy() {
    let prior = Prior::default();
    for days in [0.0, 30.0] {
        let alone = ln_ratio(&looks(300, 0), days);
        assert!(alone > 0.0 && alone <= -prior.copied.ln(), "{alone}");
    }
    let worn = |agrees: f64| [looks(300, 0), vec![piece(PieceKind::Wear, agrees); 3]].concat();
    assert_eq!(weigh(&worn(4.0), &prior).answer, Answer::Same);
    assert!(ln_ratio(&worn(-4.0), 0.0) < -prior.ln_odds);
}

#[test]
fn wear_that_agrees_outweighs_change_and_wear_that_differs_makes_a_double() {
    let later = Prior { days_apart: 30.0, ..Prior::default() };
    let mut pieces = looks(60, 40);
    assert_eq!(weigh(&pieces, &later).answer, Answer::CannotTell);
    pieces.extend([piece(PieceKind::Wear, 6.0); 6]);
    assert_eq!(weigh(&pieces, &later).answer, Answer::SameChanged);
    // Within one day nobody moves so much.
    assert_eq!(weigh(&pieces, &Prior::default()).answer, Answer::CannotTell);
    let mut pieces = looks(100, 0);
    assert_eq!(weigh(&pieces, &later).answer, Answer::CannotTell);
    pieces.extend([piece(PieceKind::Wear, -6.0); 20]);
    assert_eq!([Prior::default(), later].map(|prior| weigh(&pieces, &prior).answer), [Answer::Different; 2]);
}

/// Things move in a month and walls do not: half of the wear differs in no place, though half of the things may.
#[test]
fn wear_changes_less_than_things_do() {
    let later = Prior { days_apart: 30.0, ..Prior::default() };
    let of = |agrees: usize, differs: usize| {
        let wear = [vec![6.0; agrees], vec![-6.0; differs]].concat();
        let wear: Vec<Piece> = wear.into_iter().map(|l| piece(PieceKind::Wear, l)).collect();
        weigh(&[looks(60, 25), wear].concat(), &later).answer
    };
    assert_eq!(of(36, 0), Answer::SameChanged);
    assert_eq!(of(35, 1), Answer::SameChanged);
    assert_ne!(of(18, 18), Answer::SameChanged);
}

/// However many there are: wallpaper agrees everywhere, and a shop may be filled anew in a night.
#[test]
fn neither_wear_nor_change_says_more_than_its_own_double() {
    let prior = Prior::default();
    let worn = [looks(300, 0), vec![piece(PieceKind::Wear, 9.0); 300]].concat();
    let most = -prior.copied.ln() - prior.printed.ln();
    let found = weigh(&worn, &prior).ln_ratio;
    assert!(found > most - 1.5 && found <= most, "{found} of {most}");
    let other = weigh(&looks(0, 300), &prior).ln_ratio;
    let least = prior.rearranged.ln() - (1.0 - prior.copied).ln();
    assert!((other - least).abs() < 0.1, "{other}");
    // Where no place is a copy of another.
    let prior = Prior { copied: 0.0, ..prior };
    let most = prior.changed().recip().ln() - prior.printed.ln();
    let found = weigh(&worn, &prior).ln_ratio;
    assert!(found > most - 1.5 && found <= most, "{found} of {most}");
    let other = weigh(&looks(0, 300), &prior).ln_ratio;
    assert!((other - prior.rearranged.ln()).abs() < 0.1, "{other}");
}

/// Wear that agrees outweighs a little that differs in a place that was likely rearranged; where much differs it does so no more than in others.
#[test]
fn a_place_that_was_rearranged_is_told_as_others_where_much_differs() {
    let likely = Prior { rearranged: 0.2, copied: 0.0, ..Prior::default() };
    let bounded = Prior { rearranged_up_to: 0.1, ..likely.clone() };
    let rarely = Prior { rearranged: Prior::default().rearranged, ..likely.clone() };
    let seen = |others: usize| {
        let wear = vec![piece(PieceKind::Wear, 12.0); 6];
        [vec![piece(PieceKind::Look, 20.0); 40], vec![piece(PieceKind::Look, -30.0); others], wear].concat()
    };
    let ratios = |others| [&likely, &bounded, &rarely].map(|prior| weigh(&seen(others), prior).ln_ratio);
    let [few, few_bounded, _] = ratios(4);
    assert_eq!(few, few_bounded);
    let [much, much_bounded, much_rarely] = ratios(15);
    assert!(likely.answer(much, 0.2).joins() && much_bounded == much_rarely, "{much} {much_bounded}");
    assert!(!rarely.answer(much_rarely, 0.2).joins(), "{much_rarely}");
}

/// A pose at which more is alike explains more, one at which things differ besides explains less, and at the best much is alike.
#[test]
fn what_agrees_explains_and_what_differs_does_not() {
    let of = |similar, other| explained(&looks(similar, other), &Prior::default());
    assert!(explained(&[], &Prior::default()).abs() < 1e-9);
    assert!(of(12, 0) > of(6, 0) && of(6, 0) > of(6, 3) && of(40, 10) > of(6, 0));
    assert!(of(14, 9) < of(12, 0) - 9.0, "{} {}", of(14, 9), of(12, 0));
}

/// Twenty equal windows that agree are one fact.
#[test]
fn what_occurs_often_says_little() {
    let one = ln_ratio(&[piece(PieceKind::Look, 4.0)], 0.0);
    let equal = Piece { occurrences: 20.0, ..piece(PieceKind::Look, 4.0) };
    assert!((ln_ratio(&[equal; 20], 0.0) - one).abs() < 1e-9);
}

#[test]
fn the_order_of_pieces_changes_no_bit() {
    let mut pieces: Vec<Piece> = (0..40)
        .map(|i| Piece { share: f64::from(i), ..piece(PieceKind::Wear, f64::from(i) * 0.37 - 4.0) })
        .collect();
    let before = ln_ratio(&pieces, 1.0);
    pieces.rotate_left(13);
    pieces.reverse();
    assert_eq!(ln_ratio(&pieces, 1.0).to_bits(), before.to_bits());
}
