//! Runs loopbox over sequences with ground truth, merges their maps, and writes what came out into documents.
//!
//! It knows the program only from outside: its command line and the files it writes.

mod crowd;
mod doubles;
mod doubt;
mod faults;
mod fleet;
mod lidar;
mod live;
mod measure;
mod merging;
mod perturbed;
mod rendering;
mod report;
mod sequences;
mod side_by_side;
mod similar_places;
mod targets;
mod town;

use anyhow::{Result, bail};
use clap::Parser;
use measure::{Measurement, Runner};
use measuring::document;
use merging::Merging;
use sequences::{name, sequences};
use std::path::PathBuf;

/// Measure loopbox on sequences with ground truth and write the results into documents
#[derive(Debug, Parser)]
struct Args {
    /// Folder of sequences: each with images/, times.txt, camera.yaml, groundtruth.txt, maybe depth/
    #[arg(long)]
    data: PathBuf,
    /// The loopbox program
    #[arg(long)]
    loopbox: PathBuf,
    /// Folder for the runs' outputs
    #[arg(long)]
    work: PathBuf,
    /// Runs of each sequence with all cores
    #[arg(long, default_value_t = 3)]
    runs: usize,
    /// Measure only these sequences; by default all
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// Measure merging only
    #[arg(long)]
    merges: bool,
    /// Merge maps that lie in the work folder from an earlier measurement instead of making them again
    #[arg(long)]
    reuse: bool,
    /// Random pairs of parts of maps that are merged
    #[arg(long, value_name = "N", default_value_t = 100)]
    cuts: usize,
    /// Measure only what concerns cameras: latency, dropped frames, what watching and recording cost, replays and
    /// calibration. The machine should have nothing else to do
    #[arg(long, conflicts_with_all = ["merges", "only"])]
    live: bool,
    /// Measure only how much the results owe to luck: every sequence from other first frames and with noise
    #[arg(long, conflicts_with_all = ["merges", "live"])]
    perturbed: bool,
    /// Measure only LiDAR agents, on the folders of scans with groundtruth.txt within --data
    #[arg(long, conflicts_with_all = ["merges", "live", "perturbed"])]
    lidar: bool,
    /// Measure only a drive of so many frames through a rendered town: what costs when the map has grown
    #[arg(long, value_name = "FRAMES", conflicts_with_all = ["merges", "live", "perturbed", "lidar"])]
    long: Option<usize>,
    /// Measure only agents that pair: bytes and seconds until two maps that meet over a network are merged. The machine
    /// should have nothing else to do
    #[arg(long, conflicts_with_all = ["merges", "live", "perturbed", "lidar", "long"])]
    fleet: bool,
    /// Measure only so many pairs of maps of rendered places that look alike: none of different places may be merged
    #[arg(long, value_name = "PAIRS", conflicts_with_all = ["merges", "live", "perturbed", "lidar", "long", "fleet"])]
    strangers: Option<usize>,
    /// Measure only so many rendered places of each kind beside their doubles, which share what is made in numbers, and beside themselves
    /// after things were moved: --only names kinds
    #[arg(long, value_name = "PLACES", conflicts_with_all = ["merges", "live", "perturbed", "lidar", "long", "fleet", "strangers"])]
    doubles: Option<u64>,
    /// With --doubles: days between the two maps, as the program is told
    #[arg(long, value_name = "DAYS", default_value_t = 0.0, requires = "doubles")]
    days_apart: f64,
    /// Measure only rendered recordings of so many seeds to which something happens: --only names what
    #[arg(long, value_name = "SEEDS", conflicts_with_all = ["merges", "live", "perturbed", "lidar", "long", "fleet", "strangers", "doubles"])]
    faults: Option<u64>,
    /// Measure only rendered recordings of so many seeds on which a tracker may be sure of itself and wrong: --only names kinds
    #[arg(long, value_name = "SEEDS", conflicts_with_all = ["merges", "live", "perturbed", "lidar", "long", "fleet", "strangers", "doubles", "faults"])]
    doubt: Option<u64>,
    /// Measure only how merging grows: so many maps of rendered ways through one town merged at once, and then one more
    #[arg(long, value_name = "AGENTS", conflicts_with_all = ["merges", "live", "perturbed", "lidar", "long", "fleet", "strangers", "doubles", "faults", "doubt"])]
    crowd: Option<usize>,
    /// With --crowd: keyframes of each map
    #[arg(long, value_name = "N", default_value_t = 500, requires = "crowd")]
    keyframes: usize,
    /// With --strangers, --doubles, --faults, --doubt and --lidar: other places, from this seed on. What limits are set on must not be what they
    /// are measured on
    #[arg(long, value_name = "N", default_value_t = 2)]
    seed: u64,
    /// With --perturbed: from how many first frames each sequence is run
    #[arg(long, value_name = "N", default_value_t = 16, requires = "perturbed")]
    starts: usize,
    /// With --perturbed: with how many draws of noise each sequence is run
    #[arg(long, value_name = "N", default_value_t = 8, requires = "perturbed")]
    seeds: usize,
    /// With --live, --lidar and --fleet: this part of it only, and print its tables instead of writing them
    #[arg(long)]
    part: Option<Part>,
    /// With --fleet: how often a program is killed, in all
    #[arg(long, value_name = "N", default_value_t = 100, requires = "fleet")]
    kills: usize,
    /// With --live: minutes of the longest run
    #[arg(long, value_name = "N", default_value_t = 5.0, requires = "live")]
    minutes: f64,
    /// Documents to write the results into, between their markers
    documents: Vec<PathBuf>,
}

/// Parts of a measurement that can be measured alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Part {
    /// Of --live: calibrations against known ones.
    Calibration,
    /// Of --live: the cost of recording and watching.
    Costs,
    /// Of --lidar: pairs of stretches of the recordings.
    Recorded,
    /// Of --lidar: pairs of stretches of drives through rendered sites.
    Rendered,
    /// Of --lidar: places that are built alike, and places of which some things were moved; --only names kinds.
    Doubles,
    /// Of --lidar: an hour along one way.
    Hour,
    /// Of --fleet: two maps that meet.
    Meetings,
    /// Of --fleet: frame times beside a link.
    Links,
    /// Of --fleet: programs killed or standing still, a full disk.
    Breaking,
    /// Of --fleet: a hundred agents that come one a second.
    Hundred,
}

impl Part {
    /// Whether it is of the measurement that is asked for.
    fn suits(self, args: &Args) -> bool {
        match self {
            Self::Calibration | Self::Costs => args.live,
            Self::Recorded | Self::Rendered | Self::Doubles | Self::Hour => args.lidar,
            Self::Meetings | Self::Links | Self::Breaking | Self::Hundred => args.fleet,
        }
    }
}

fn main() -> Result<()> {
    let args = Args::parse();
    if args.runs == 0 {
        bail!("--runs 0 measures nothing");
    }
    if args.part.is_some_and(|part| !part.suits(&args)) {
        bail!(
            "--part: calibration and costs are parts of --live, recorded, rendered, doubles and hour of --lidar, meetings, links, \
             breaking and hundred of --fleet"
        );
    }
    document::check(&args.documents)?;
    let runner = Runner { loopbox: args.loopbox.clone(), work: args.work.clone(), runs: args.runs };
    if args.live {
        return measure_live(&args, &runner);
    }
    if args.lidar {
        return measure_lidar(&args);
    }
    if args.fleet {
        return measure_fleet(&args);
    }
    if let Some(frames) = args.long {
        let drive = town::measure(&runner, frames)?;
        return write(&args.documents, &[("long", town::section(&drive))]);
    }
    if let Some(pairs) = args.strangers {
        return measure_strangers(&args, pairs);
    }
    if let Some(places) = args.doubles {
        return measure_doubles(&args, places);
    }
    if let Some(agents) = args.crowd {
        return measure_crowd(&args, agents);
    }
    if let Some(seeds) = args.faults {
        let seeds: Vec<u64> = (args.seed..args.seed.saturating_add(seeds)).collect();
        let all = faults::measure(&runner, &seeds, &args.only)?;
        return write(&args.documents, &[("faults", faults::section(&all))]);
    }
    if let Some(seeds) = args.doubt {
        let seeds: Vec<u64> = (args.seed..args.seed.saturating_add(seeds)).collect();
        let all = doubt::measure(&runner, &seeds, &args.only)?;
        return write(&args.documents, &[("doubt", doubt::section(&all, &seeds))]);
    }
    let found = sequences(&args.data, &args.only)?;
    if args.perturbed {
        let (starts, seeds) = (args.starts, args.seeds);
        let plan = perturbed::Plan { runner: &runner, sequences: &found, starts, seeds };
        let all = perturbed::measure(&plan)?;
        return write(&args.documents, &[("perturbed", perturbed::section(&all))]);
    }
    measure_all(&args, &runner, &found)
}

/// Measures the runs of all sequences, and the merges of their maps.
fn measure_all(args: &Args, runner: &Runner, found: &[PathBuf]) -> Result<()> {
    let mut sections = vec![("machine", report::machine())];
    let mut failed = Vec::new();
    if !args.merges {
        let measurements = measure_sequences(runner, found)?;
        sections.push(("results", report::results(&measurements, args.runs)));
        sections.push(("summary", report::summary(&measurements)));
        failed = measurements.into_iter().filter(|m| m.failure.is_some()).map(|m| m.name).collect();
    }
    let names: Vec<String> =
        found.iter().map(|path| name(path)).filter(|name| !failed.contains(name)).collect();
    let mut wrong = 0;
    if names.len() > 1 {
        let merging = merging::measure(&merging::Plan {
            runner,
            data: &args.data,
            sequences: &names,
            mapped: !args.merges,
            reuse: args.reuse,
            cuts: args.cuts,
        })?;
        wrong = merging.wrong().count();
        sections.extend(merging_sections(&merging, args.runs));
    }
    write(&args.documents, &sections)?;
    if !failed.is_empty() {
        bail!("no figures for {}: see the messages above", failed.join(", "));
    }
    if wrong > 0 {
        bail!("{wrong} pairs of maps were merged wrongly");
    }
    Ok(())
}

/// Measures one part of what concerns cameras, and prints it.
fn measure_part(plan: &live::Plan, part: Part) -> Result<()> {
    let (text, problem) = if part == Part::Calibration {
        let found = live::measure_calibrations(plan)?;
        (live::report::calibrations(&found), found.err())
    } else {
        let found = live::measure_costs(plan)?;
        (live::report::costs(&found), found.err())
    };
    println!("{text}");
    problem.map_or(Ok(()), |reason| bail!(reason))
}

/// Measures what concerns agents that pair.
fn measure_fleet(args: &Args) -> Result<()> {
    let (data, work, only) = (&args.data, &args.work, &args.only);
    let plan = fleet::Plan { loopbox: &args.loopbox, data, work, runs: args.runs, kills: args.kills, only };
    if let Some(part) = args.part {
        println!("{}", fleet_part(&plan, part)?);
        return Ok(());
    }
    let parts = [Part::Meetings, Part::Links, Part::Breaking, Part::Hundred];
    let parts = parts.into_iter().map(|part| fleet_part(&plan, part)).collect::<Result<Vec<_>>>()?;
    write(&args.documents, &[("fleet", parts.concat())])
}

/// Measures one part of what concerns agents that pair.
fn fleet_part(plan: &fleet::Plan, part: Part) -> Result<String> {
    match part {
        Part::Links => fleet::link_load::measure(plan),
        Part::Breaking => fleet::breaking::measure(plan),
        Part::Hundred => fleet::hundred::measure(plan),
        _ => fleet::measure(plan),
    }
}

/// Measures what concerns LiDARs.
fn measure_lidar(args: &Args) -> Result<()> {
    let (loopbox, data, work) = (&args.loopbox, &args.data, &args.work);
    let plan = lidar::Plan { loopbox, data, work, reuse: args.reuse, seed: args.seed, only: &args.only };
    if let Some(part) = args.part {
        return print_lidar(&plan, part, &args.documents);
    }
    write(&args.documents, &[("machine", report::machine())])?;
    lidar::measure(&plan, |name, text| write(&args.documents, &[(name, text)]))
}

/// Measures one part of what concerns LiDARs, and prints it; that of doubles is written into the documents.
fn print_lidar(plan: &lidar::Plan, part: Part, documents: &[PathBuf]) -> Result<()> {
    if part == Part::Doubles {
        return lidar::doubles(plan, |name, text| write(documents, &[(name, text)]));
    }
    if part == Part::Hour {
        println!("{}", lidar::hour(plan)?);
        return Ok(());
    }
    let lot = match part {
        Part::Recorded => lidar::Lot::Recorded,
        _ => lidar::Lot::Rendered,
    };
    let (text, wrong) = lidar::strangers(plan, lot)?;
    println!("{text}");
    match wrong {
        0 => Ok(()),
        wrong => bail!("{wrong} pairs were merged wrongly"),
    }
}

/// Measures how merging grows with the number of maps.
fn measure_crowd(args: &Args, agents: usize) -> Result<()> {
    let program = merging::Program { loopbox: args.loopbox.clone() };
    let plan = crowd::Plan { program: &program, work: &args.work, agents, keyframes: args.keyframes };
    let measured = crowd::measure(&plan)?;
    write(&args.documents, &[("crowd", crowd::report::section(&measured, agents, args.keyframes))])
}

/// Measures merges of places that look alike.
fn measure_strangers(args: &Args, pairs: usize) -> Result<()> {
    let program = merging::Program { loopbox: args.loopbox.clone() };
    let plan = similar_places::Plan { program: &program, work: &args.work, pairs, seed: args.seed };
    let measured = similar_places::measure(&plan)?;
    write(&args.documents, &[("strangers", similar_places::report::section(&measured, args.seed))])?;
    match similar_places::report::wrong(&measured) {
        0 => Ok(()),
        wrong => bail!("{wrong} pairs of maps were merged wrongly"),
    }
}

/// Measures merges of places and their doubles.
fn measure_doubles(args: &Args, places: u64) -> Result<()> {
    let program = merging::Program { loopbox: args.loopbox.clone() };
    let (work, seed, only, days_apart) = (&args.work, args.seed, &args.only, args.days_apart);
    let plan = doubles::Plan { program: &program, work, places, seed, only, days_apart };
    let pairs = doubles::measure(&plan)?;
    let text = doubles::section(&pairs, seed, days_apart);
    if only.is_empty() {
        let name = if days_apart > 0.0 { "doubles-later" } else { "doubles" };
        write(&args.documents, &[(name, text)])?;
    } else {
        println!("{text}");
    }
    match doubles::wrong(&pairs) {
        0 => Ok(()),
        wrong => bail!("{wrong} pairs of maps were merged wrongly"),
    }
}

/// Measures what concerns cameras.
fn measure_live(args: &Args, runner: &Runner) -> Result<()> {
    let plan = live::Plan { runner, data: &args.data, minutes: args.minutes };
    if let Some(part) = args.part {
        return measure_part(&plan, part);
    }
    let live = live::measure(&plan)?;
    let text = live::report::section(&live);
    write(&args.documents, &[("machine", report::machine()), ("live", text)])?;
    match live.problems() {
        problems if problems.is_empty() => Ok(()),
        problems => bail!("{}", problems.join("\n")),
    }
}

/// Writes sections into the documents; without any, prints them.
fn write(documents: &[PathBuf], sections: &[(&str, String)]) -> Result<()> {
    for path in documents {
        document::update(path, sections)?;
    }
    if documents.is_empty() {
        sections.iter().for_each(|(_, text)| println!("{text}"));
    }
    Ok(())
}

fn measure_sequences(runner: &Runner, sequences: &[PathBuf]) -> Result<Vec<Measurement>> {
    let mut measurements = Vec::new();
    for sequence in sequences {
        let measurement = runner.measure(sequence)?;
        eprintln!("{}", report::line(&measurement));
        measurements.push(measurement);
    }
    Ok(measurements)
}

/// What the documents say of merging.
fn merging_sections(merging: &Merging, runs: usize) -> [(&'static str, String); 4] {
    use merging::report;
    [
        ("merging", report::cases(merging, runs)),
        ("methods", report::methods(merging)),
        ("refusals", report::refusals(merging)),
        ("merging-summary", report::summary(merging)),
    ]
}
