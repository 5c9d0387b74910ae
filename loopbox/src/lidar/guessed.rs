//! Stretches of a LiDAR's path that are guessed, since what the scans show does not determine all of the motion.

use super::scan_row::ScanRow;
use serde::Serialize;

/// A stretch of the path whose scans do not determine all of the motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GuessedRow {
    /// Instant of the first of its scans, seconds.
    pub from_s: f64,
    /// Instant of the last of its scans, seconds.
    pub to_s: f64,
    /// Its scans with something guessed.
    pub scans: usize,
    /// Most directions of the translation, of three, that a scan leaves open.
    pub directions: usize,
    /// Metres of the path that are guessed.
    pub metres: f64,
    /// What its end may err by, standard deviation, metres.
    pub deviation_m: f64,
}

/// Guessed scans at most so many seconds apart are of one stretch.
const ONE_STRETCH: f64 = 2.0;
/// So many stretches are named; the others are counted.
const NAMED: usize = 3;

impl GuessedRow {
    /// The stretches of a run.
    pub fn of(rows: &[ScanRow]) -> Vec<Self> {
        let mut stretches: Vec<Self> = Vec::new();
        // What was guessed before the last scan that is not.
        let mut before = 0.0f64;
        let mut last = 0.0;
        for row in rows {
            if row.guessed == 0 {
                (before, last) = (before.hypot(last), 0.0);
                continue;
            }
            if stretches.last().is_none_or(|stretch| row.instant - stretch.to_s > ONE_STRETCH) {
                let (from_s, to_s) = (row.instant, row.instant);
                stretches.push(Self { from_s, to_s, scans: 0, directions: 0, metres: 0.0, deviation_m: 0.0 });
                before = 0.0;
            }
            let Some(stretch) = stretches.last_mut() else { continue };
            last = row.guessed_deviation_m;
            stretch.to_s = row.instant;
            stretch.scans += 1;
            stretch.directions = stretch.directions.max(row.guessed);
            stretch.metres += row.guessed_m;
            stretch.deviation_m = stretch.deviation_m.max(before.hypot(last));
        }
        stretches
    }

    /// As it is said.
    fn text(&self) -> String {
        let Self { from_s, to_s, metres, deviation_m, .. } = self;
        format!("{metres:.1} m (± {deviation_m:.1} m) from {from_s:.1} to {to_s:.1} s")
    }
}

/// Metres of the path that are guessed, in all.
pub fn metres(guessed: &[GuessedRow]) -> f64 {
    guessed.iter().map(|row| row.metres).sum()
}

/// What to say of a run of which a part is guessed; nothing of others.
pub fn doubtful(guessed: &[GuessedRow]) -> Option<String> {
    let metres = metres(guessed);
    let mut parts: Vec<String> = guessed.iter().take(NAMED).map(GuessedRow::text).collect();
    if let Some(more) = guessed.len().checked_sub(NAMED).filter(|more| *more > 0) {
        parts.push(format!("and {more} more"));
    }
    (!guessed.is_empty()).then(|| {
        format!(
            "{metres:.1} m of the path are guessed and doubtful, since the scans do not determine all of the motion, as in a smooth tunnel \
             or on open ground: {}",
            parts.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(instant: f64, guessed_m: f64) -> ScanRow {
        let guessed = usize::from(guessed_m > 0.0);
        ScanRow { instant, guessed, guessed_m, guessed_deviation_m: 0.5 * guessed_m, ..ScanRow::default() }
    }

    #[test]
    fn stretches_are_counted_and_named() {
        let rows = [row(0.0, 0.0), row(1.0, 0.2), row(2.0, 0.6), row(3.0, 0.0), row(3.5, 0.8), row(9.0, 1.0)];
        let found = GuessedRow::of(&rows);
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].from_s, found[0].to_s, found[0].scans), (1.0, 3.5, 3));
        // 0.3 m until a scan was determined, and 0.4 m since.
        assert!((found[0].deviation_m - 0.5).abs() < 1e-9, "{found:?}");
        let said = doubtful(&found).unwrap();
        assert!(said.starts_with("2.6 m") && said.contains("1.6 m (± 0.5 m) from 1.0 to 3.5 s"), "{said}");
        assert_eq!(doubtful(&GuessedRow::of(&rows[..1])), None);
        let many: Vec<ScanRow> = (0..5).map(|k| row(10.0 * f64::from(k), 1.0)).collect();
        assert!(doubtful(&GuessedRow::of(&many)).unwrap().ends_with("and 2 more"));
    }
}
