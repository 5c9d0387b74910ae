//! How the files of a run's results are called.

/// The map.
pub const MAP: &str = "map.mcap";
/// The poses as they stand at the end.
pub const TRAJECTORY: &str = "trajectory.txt";
/// The poses as they were handed out, before what came later corrected them.
pub const LIVE_TRAJECTORY: &str = "trajectory-live.txt";

/// The file of a fragment: `map.mcap`, `map-2.mcap`, `map-3.mcap` …
pub fn numbered(name: &str, place: usize) -> String {
    match (place, name.rsplit_once('.')) {
        (0, _) | (_, None) => name.to_owned(),
        (_, Some((stem, extension))) => format!("{stem}-{}.{extension}", place + 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fragments_have_files_of_their_own() {
        assert_eq!(numbered("map.mcap", 0), "map.mcap");
        assert_eq!(numbered("map.mcap", 1), "map-2.mcap");
        assert_eq!(numbered("trajectory.txt", 2), "trajectory-3.txt");
    }
}
