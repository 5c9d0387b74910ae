//! Which program calls this library, as the results name it.

use std::sync::OnceLock;

static COMMIT: OnceLock<&'static str> = OnceLock::new();

/// Says from which commit the program was built; results name it from then on. Only the first call counts.
pub fn set_commit(commit: &'static str) {
    // A second call of one program says the same.
    let _ = COMMIT.set(commit);
}

/// The commit that the program was built from, where it said so.
pub fn commit() -> Option<&'static str> {
    COMMIT.get().copied()
}
