//! How much of what is bare has a grain.
//!
//! Grain is all over a surface. What looks like wear and is made in numbers, ends of joints, faint lines, soft print, is here and there on
//! surfaces that show nothing else. So the share of both maps' bare surface that their own keyframes know again says whether that is grain,
//! before anything is compared across the maps. Print that is all over, as wallpaper has, it does not tell from grain.

use backend::verdict::Prior;

/// Probability that wear is made in numbers here and there and noise hides all grain: as likely as not, for nothing is known of it.
const SPARSE: f64 = 0.5;

/// Comparisons of cells of wear within each map, and how many of them are of something that was known again.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Worn {
    known: usize,
    all: usize,
}

impl Worn {
    /// By correlations, and the median of those of unrelated cells. Half of what is not known again lies below that (Storey 2002).
    pub fn new(correlations: &[f64], unrelated: f64) -> Self {
        let (all, below) = (
            correlations.len(),
            correlations.iter().filter(|correlation| **correlation <= unrelated).count(),
        );
        Self { known: all - (2 * below).min(all), all }
    }

    /// Probability that bare surface has a grain all over.
    pub fn grain(&self) -> f64 {
        1.0 / (1.0 + SPARSE / (1.0 - SPARSE) * (-self.ln_ratio()).exp())
    }

    /// What is believed, with the probability that wear is made in numbers after this was seen.
    pub fn prior(&self, prior: &Prior) -> Prior {
        Prior { printed: 1.0 - self.grain() * (1.0 - prior.printed), ..prior.clone() }
    }

    /// `ln p(so many known | grain) − ln p(so many known | here and there)`. The share that is known is distributed as `Beta(4, 1)` where there
    /// is grain, four fifths on average, for noise hides some, and as `Beta(1, 9)` where there is none, a tenth; so the numbers are
    /// beta-binomial. Of none it is 0.
    fn ln_ratio(&self) -> f64 {
        let [known, unknown, all] = [self.known, self.all - self.known, self.all].map(|count| count as f64);
        let ln_product = |from: f64, count: i32| (0..count).map(|i| (from + f64::from(i)).ln()).sum::<f64>();
        // B(known + 4, unknown + 1)/B(4, 1) over B(known + 1, unknown + 9)/B(1, 9).
        let ratio = ln_product(known + 1.0, 3) + ln_product(all + 5.0, 5) - ln_product(unknown + 1.0, 8);
        (4.0f64 / 9.0).ln() + ratio
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn printed(known: usize, all: usize) -> f64 {
        Worn { known, all }.prior(&Prior::default()).printed
    }

    /// What is known here and there on bare surface is no grain; where most is, it is.
    #[test]
    fn wear_that_is_here_and_there_is_made_in_numbers() {
        let usual = Prior::default().printed;
        assert!(printed(0, 1000) > 0.999 && printed(20, 200) > 0.99);
        assert!(printed(120, 200) < 2.0 * usual && printed(160, 200) < 1.1 * usual);
        assert!(printed(200, 200) < 1.1 * usual && printed(8, 10) < 1.5 * usual);
        // Nothing is known without any; and the more is known, the more it is grain.
        assert!((printed(0, 0) - 0.5).abs() < 0.01);
        let all: Vec<f64> = (0..=50).map(|known| printed(known, 50)).collect();
        assert!(all.is_sorted_by(|a, b| a > b), "{all:?}");
        assert!(printed(0, 10_000_000) <= 1.0);
    }

    /// Of four comparisons in ten that are of nothing but noise, two are above the median of noise.
    #[test]
    fn half_of_what_is_not_known_is_above_the_median() {
        let correlations = [0.1, 0.2, 0.4, 0.5, 0.7, 0.7, 0.8, 0.8, 0.9, 0.9];
        let worn = Worn::new(&correlations, 0.3);
        assert_eq!((worn.known, worn.all), (6, 10));
        assert_eq!(Worn::new(&[0.1, 0.2, 0.4], 0.3).known, 0);
    }
}
