//! Which program this is: its version, commit and features.

use std::sync::LazyLock;

/// The commit that it was built from, with `+` where files were changed; empty where that is not known, as in builds of the profile `dev`.
pub const COMMIT: &str = env!("LOOPBOX_COMMIT");

/// What it was built with.
const FEATURES: [(bool, &str); 8] = [
    (cfg!(feature = "camera"), "camera"),
    (cfg!(feature = "fleet"), "fleet"),
    (cfg!(feature = "foxglove-server"), "foxglove-server"),
    (cfg!(feature = "object-store"), "object-store"),
    (cfg!(feature = "opencv"), "opencv"),
    (cfg!(feature = "ros2"), "ros2"),
    (cfg!(feature = "sqlite"), "sqlite"),
    (cfg!(feature = "view"), "view"),
];

/// The version with its commit, in a line: `0.1.0 (1a2b3c4d5e)`.
pub fn short() -> &'static str {
    static TEXT: LazyLock<String> = LazyLock::new(|| {
        let commit = if COMMIT.is_empty() { "no commit" } else { COMMIT };
        format!("{} ({commit})", env!("CARGO_PKG_VERSION"))
    });
    &TEXT
}

/// The same, and what it was built with and for.
pub fn long() -> &'static str {
    static TEXT: LazyLock<String> = LazyLock::new(described);
    &TEXT
}

fn described() -> String {
    let features: Vec<&str> = FEATURES.iter().filter(|(is_on, _)| *is_on).map(|(_, name)| *name).collect();
    let features = if features.is_empty() { "none".to_owned() } else { features.join(" ") };
    let (arch, os) = (std::env::consts::ARCH, std::env::consts::OS);
    let profile = if cfg!(debug_assertions) { "with checks" } else { "release" };
    format!("{}\nfeatures: {features}\nbuilt for: {arch} {os}, {profile}", short())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_version_says_commit_and_features() {
        assert!(short().starts_with(concat!(env!("CARGO_PKG_VERSION"), " (")));
        let long = long();
        for (is_on, name) in FEATURES {
            assert_eq!(long.split_whitespace().any(|word| word == name), is_on, "{name} in {long}");
        }
    }
}
