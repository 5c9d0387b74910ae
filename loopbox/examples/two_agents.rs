//! Maps the recordings of two agents, merges their maps and says how far each is from the truth:
//! `cargo run --release -p loopbox-core --example two_agents -- demo/parking_a demo/parking_c out`.

use loopbox::{MergeOptions, RunOptions, evaluate, merge_maps, run};
use std::path::PathBuf;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [a, b, out] = &arguments[..] else { anyhow::bail!("usage: two_agents RECORDING RECORDING OUT") };
    let mut maps = Vec::new();
    for (recording, name) in [(a, "a"), (b, "b")] {
        let mapped = run(recording, RunOptions::to(out.join(name)))?;
        let found = evaluate(&mapped.folder, &recording.join("groundtruth.txt"), None, &Default::default())?;
        println!("{}: {:.4} m", recording.display(), found.ate.rmse);
        maps.push(mapped.folder);
    }
    println!("{}", merge_maps(&maps, MergeOptions::to(out.join("merged")))?.verdict());
    Ok(())
}
