//! Measures the LiDAR libraries on folders of scans that hold `groundtruth.txt` (TUM).
//!
//! `cargo run --release -p loopbox-slam-lidar --example lidar -- COMMAND FOLDER…`
//! - `odometry`, `floam`, `a-loam`: errors and time of a sweep;
//! - `loops`: loops closed and refused, errors before and after;
//! - `sites LOT WORDS`: ray-cast drives of a lot, no folders, with the loops that are wrong and the metres that are guessed;
//! - `merge`: maps of all folders merged pair by pair, and together;
//! - `merge-emr`: the same by the paper's chain;
//! - `merge-given`: the same, with maps built on the given poses from scans that are not distorted;
//! - `merge-mirrored`: the second of each pair mirrored, so that no merge is right;
//! - `merge-cut`: all pairs of stretches of 12 m, of one folder and of different ones.

mod loops;
mod merging;
mod odometry;
mod oracle;
mod sites;
mod truth;

/// What an example may fail with.
type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some((command, folders)) = arguments.split_first() else {
        return Err("name a command and folders of scans".into());
    };
    match command.as_str() {
        "odometry" | "floam" | "a-loam" => {
            folders.iter().try_for_each(|f| odometry::run(command, f.as_ref()))
        }
        "sites" => sites::run(folders),
        "loops" => folders.iter().try_for_each(|f| loops::run(f.as_ref())),
        merge => merging::run(merge, folders),
    }
}
