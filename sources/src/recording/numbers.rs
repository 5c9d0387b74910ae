//! Sets of frame numbers as text: `3,7-9`.

use std::collections::BTreeSet;
use std::fmt;

/// Longest set to believe in: ten hours of frames.
const MOST: usize = 1 << 20;

/// A set of numbers of frames.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NumberSet(BTreeSet<u32>);

impl NumberSet {
    /// Adds a number; whether it was new.
    pub fn insert(&mut self, number: u32) -> bool {
        self.0.len() < MOST && self.0.insert(number)
    }

    /// Whether it is there.
    pub fn contains(&self, number: u32) -> bool {
        self.0.contains(&number)
    }

    /// How many there are.
    pub fn count(&self) -> u64 {
        self.0.len() as u64
    }

    /// Reads what [`Display`](fmt::Display) writes; parts that make no sense are left out.
    pub fn parse(text: &str) -> Self {
        let mut set = Self::default();
        for part in text.split(',').map(str::trim) {
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            if let (Ok(first), Ok(last)) = (first.parse::<u32>(), last.parse::<u32>()) {
                for number in (first..=last).take(MOST - set.0.len()) {
                    set.insert(number);
                }
            }
        }
        set
    }
}

impl fmt::Display for NumberSet {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let mut numbers = self.0.iter().copied().peekable();
        let mut separator = "";
        while let Some(first) = numbers.next() {
            let mut last = first;
            while let Some(next) = numbers.next_if(|&next| Some(next) == last.checked_add(1)) {
                last = next;
            }
            match last - first {
                0 => write!(f, "{separator}{first}")?,
                _ => write!(f, "{separator}{first}-{last}")?,
            }
            separator = ",";
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_comes_back() {
        let mut set = NumberSet::default();
        [9, 3, 7, 8, 3, u32::MAX].into_iter().for_each(|number| _ = set.insert(number));
        assert_eq!(set.to_string(), "3,7-9,4294967295");
        assert_eq!(NumberSet::parse(&set.to_string()), set);
        assert_eq!(NumberSet::default().to_string(), "");
        assert_eq!(NumberSet::parse(""), NumberSet::default());
        assert_eq!(NumberSet::parse("x,5-,4-2,6").to_string(), "6");
        assert_eq!(NumberSet::parse("0-4294967295").count(), MOST as u64);
    }
}
