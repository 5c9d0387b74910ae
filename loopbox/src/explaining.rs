//! Errors as people read them.

/// An error for people: what failed and why on the first line, each cause once, and the hints after it.
pub fn explained(error: &anyhow::Error) -> String {
    let (mut text, mut rest) = (String::new(), String::new());
    for cause in error.chain() {
        let cause = cause.to_string();
        let (what, more) = cause.split_once('\n').unwrap_or((&cause, ""));
        if !text.contains(what) {
            text += if text.is_empty() { "" } else { ": " };
            text += what;
        }
        if !more.is_empty() {
            rest += "\n";
            rest += more;
        }
    }
    text + &rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_come_once_and_before_the_hints() {
        let disk = || std::io::Error::other("disk full");
        let error = anyhow::Error::new(disk()).context("m.mcap: cannot be written\nhint: make room");
        assert_eq!(explained(&error), "m.mcap: cannot be written: disk full\nhint: make room");
        let twice = anyhow::Error::new(disk()).context("m.mcap: cannot be read: disk full");
        assert_eq!(explained(&twice), "m.mcap: cannot be read: disk full");
    }
}
