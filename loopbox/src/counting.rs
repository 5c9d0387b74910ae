//! Counts as people read them.

use std::fmt::Display;

/// A count and its noun, `one` or `many`: `1 loop`, `0 loops`.
pub fn counted<N: Display + From<u8> + PartialEq>(count: N, one: &str, many: &str) -> String {
    let noun = if count == N::from(1) { one } else { many };
    format!("{count} {noun}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_singular_and_any_other_count_is_plural() {
        let loops = |count: usize| counted(count, "loop", "loops");
        assert_eq!([0, 1, 2].map(loops), ["0 loops", "1 loop", "2 loops"]);
    }
}
