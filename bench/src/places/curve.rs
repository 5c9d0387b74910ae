//! Precision and recall.

/// What the best candidate of a query was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    Right,
    Wrong,
    /// It overlaps with the query a little.
    Unclear,
}

/// Best candidates of many queries.
#[derive(Clone, Debug, Default)]
pub struct Curve {
    /// Score and verdict of each query with a candidate.
    answers: Vec<(f32, Verdict)>,
    /// How many queries have a right answer in the index.
    possible: usize,
}

impl Curve {
    /// Counts a query that has a right answer.
    pub fn expect(&mut self) {
        self.possible += 1;
    }

    /// Counts a query's best candidate.
    pub fn answer(&mut self, score: f32, verdict: Verdict) {
        self.answers.push((score, verdict));
    }

    /// Adds the queries of another.
    pub fn join(&mut self, other: &Self) {
        self.answers.extend(&other.answers);
        self.possible += other.possible;
    }

    /// How many queries have a right answer.
    pub fn possible(&self) -> usize {
        self.possible
    }

    /// The highest score of an answer, 0 without one.
    pub fn highest(&self) -> f32 {
        self.answers.iter().map(|answer| answer.0).fold(0.0, f32::max)
    }

    /// The highest recall with at least the given precision, 0–1, and the least score that gives it.
    pub fn recall_at(&self, precision: f64) -> Option<(f64, f32)> {
        let mut best = None;
        for (score, found_precision, recall) in self.points() {
            if found_precision >= precision {
                best = Some((recall, score));
            }
        }
        best
    }

    /// The share of queries with a right answer whose best candidate is right, at any score.
    pub fn recall(&self) -> f64 {
        self.points().last().map_or(0.0, |&(_, _, recall)| recall)
    }

    /// The recall of answers that score more than `score`, 0–1.
    pub fn recall_above(&self, score: f32) -> f64 {
        let above = self.answers.iter().filter(|a| a.0 > score && a.1 == Verdict::Right);
        above.count() as f64 / self.possible.max(1) as f64
    }

    /// Area under the curve of precision over recall (average precision), 0–1.
    pub fn average_precision(&self) -> f64 {
        let (mut area, mut before) = (0.0, 0.0);
        for (_, precision, recall) in self.points() {
            area += precision * (recall - before);
            before = recall;
        }
        area
    }

    /// `(score, precision, recall)` when answers from that score on are taken; equal scores are taken together.
    fn points(&self) -> Vec<(f32, f64, f64)> {
        let mut answers = self.answers.clone();
        answers.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (mut right, mut wrong, mut points) = (0usize, 0usize, Vec::new());
        for same in answers.chunk_by(|a, b| a.0 == b.0) {
            right += same.iter().filter(|a| a.1 == Verdict::Right).count();
            wrong += same.iter().filter(|a| a.1 == Verdict::Wrong).count();
            if right + wrong > 0 {
                let recall = right as f64 / self.possible.max(1) as f64;
                points.push((same[0].0, right as f64 / (right + wrong) as f64, recall));
            }
        }
        points
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_answer_between_right_ones_lowers_precision_from_there_on() {
        let mut curve = Curve::default();
        (0..4).for_each(|_| curve.expect());
        for (score, verdict) in
            [(0.9, Verdict::Right), (0.8, Verdict::Unclear), (0.7, Verdict::Wrong), (0.6, Verdict::Right)]
        {
            curve.answer(score, verdict);
        }
        assert_eq!(curve.recall_at(1.0), Some((0.25, 0.8)));
        assert_eq!(curve.recall_at(0.6), Some((0.5, 0.6)));
        assert_eq!(curve.recall_at(0.99).map(|r| r.0), Some(0.25));
        assert!((curve.average_precision() - (0.25 + 0.25 * 2.0 / 3.0)).abs() < 1e-12);
        assert_eq!(curve.recall(), 0.5);
    }

    #[test]
    fn nothing_right_is_no_recall() {
        let mut curve = Curve::default();
        curve.answer(0.9, Verdict::Wrong);
        assert_eq!(curve.recall_at(1.0), None);
        assert_eq!(curve.average_precision(), 0.0);
    }
}
