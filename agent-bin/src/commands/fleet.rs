//! `loopbox fleet`: how things are with agents that pair; and `run --fleet`.

mod demo;

use super::keys::KeysArg;
use crate::console::{self, Ended, Ending, tell, usage};
use crate::interrupt::stop_on_ctrl_c;
use crate::logging;
use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use loopbox::fleet::{Endpoint, Fleet, FleetOptions, LinkLine, StatusFile, read_status};
use loopbox::open::map_file_at;
use loopbox::store::Store;
use map::SensorKind;
use sources::Stop;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How long an agent whose run is over waits for others that it could not reach.
const PATIENCE: Duration = Duration::from_secs(5);

/// List the agents, links and verdicts of a station or an agent, or see two agents and a station pair; exit code 5 when it was
/// killed, or nobody answers where it dials
#[derive(Debug, Args)]
pub struct FleetCommand {
    /// The folder of `loopbox station`, or of `loopbox run --fleet`
    #[arg(value_name = "DIR", required_unless_present = "demo", conflicts_with = "demo")]
    folder: Option<PathBuf>,
    /// Tell the map in this folder, of a run whose neighbours were not there, to a station or an agent; may be given again
    #[arg(long, value_name = "ADDRESS", conflicts_with_all = ["demo", "json"])]
    connect: Vec<Endpoint>,
    /// Tell the map in this folder to whoever dials, and take theirs
    #[arg(long, value_name = "ADDRESS", conflicts_with_all = ["demo", "json"])]
    listen: Option<Endpoint>,
    #[command(flatten)]
    keys: KeysArg,
    /// Print it as JSON
    #[arg(long, conflicts_with = "demo")]
    json: bool,
    /// Run a station and two agents on this machine that replay the two recordings in this folder
    #[arg(long, value_name = "RECORDINGS", num_args = 0..=1, require_equals = true, default_missing_value = "demo")]
    demo: Option<PathBuf>,
    /// Folder for the results of --demo
    #[arg(short, long, value_name = "DIR", default_value = "out/fleet", requires = "demo")]
    out: PathBuf,
}

/// How a run pairs.
#[derive(Debug, Args)]
pub struct PairingArgs {
    /// Tell the map to others while it grows, and merge it with theirs, under this name; default:
    /// that of the folder --out
    #[arg(long, value_name = "NAME", num_args = 0..=1, require_equals = true)]
    fleet: Option<Option<String>>,
    /// With --fleet: where others reach this agent, tls/0.0.0.0:PORT with --keys, or tcp/127.0.0.1:PORT
    #[arg(long, value_name = "ADDRESS", requires = "fleet")]
    listen: Option<Endpoint>,
    /// With --fleet: a station or an agent to dial; may be given again
    #[arg(long, value_name = "ADDRESS", requires = "fleet")]
    connect: Vec<Endpoint>,
    #[command(flatten)]
    keys: KeysArg,
    /// Put the map into this store once the run has ended well, for `loopbox worker` and `merge`; with or without --fleet, no station is
    /// needed: a folder, or in a bucket s3://BUCKET/PREFIX, gs://… or az://…; the map is STORE/maps/SHA-256.mcap there
    #[arg(long, value_name = "STORE", conflicts_with_all = ["check", "repeat", "localise"])]
    store: Option<PathBuf>,
}

impl PairingArgs {
    /// The store that gets the map, if that was asked for.
    ///
    /// # Errors
    /// When it cannot be used.
    pub fn store(&self) -> Result<Option<Store>> {
        self.store.as_deref().map(Store::at).transpose()
    }

    /// Whether the run is to pair.
    pub fn is_wanted(&self) -> bool {
        self.fleet.is_some()
    }

    /// Starts what pairs, if that was asked for.
    ///
    /// # Errors
    /// When nobody could reach it or be reached, or an address cannot be listened at.
    pub fn start(&self, out: &Path, quiet: bool) -> Result<Option<Fleet>> {
        let Some(name) = &self.fleet else {
            return match self.keys.folder() {
                Some(_) => usage(Err(anyhow!("--keys is for --fleet\nhint: give both, or leave --keys out"))),
                None => Ok(None),
            };
        };
        if self.listen.is_none() && self.connect.is_empty() {
            bail!(
                "--fleet: nobody could be reached\nhint: --connect tcp/127.0.0.1:7447 dials a station or an agent, \
                 --listen tcp/127.0.0.1:7447 lets one dial"
            );
        }
        let of_folder =
            || out.file_name().map_or_else(|| "agent".into(), |n| n.to_string_lossy().into_owned());
        let options = FleetOptions {
            store: None,
            out: out.to_owned(),
            force: false,
            name: name.clone().unwrap_or_else(of_folder),
            is_station: false,
            in_background: true,
            listen: self.listen.clone(),
            dial: self.connect.clone(),
            keys: self.keys.folder(),
        };
        let fleet = Fleet::start(
            &options,
            None,
            move |level, text| {
                if !quiet {
                    logging::write(level, "", format_args!("fleet: {text}"));
                }
            },
            Vec::new(),
        )?;
        if let Some(at) = fleet.listening().filter(|_| !quiet) {
            tell!("fleet: others reach this agent by --connect {}", at.for_others());
        }
        Ok(Some(fleet))
    }

    /// The command that tells a map that is kept.
    fn again(&self, out: &Path) -> String {
        let quoted = |text: &str| {
            let is_plain = |c: char| c.is_ascii_alphanumeric() || "/._-:".contains(c);
            if text.chars().all(is_plain) {
                text.to_owned()
            } else {
                format!("'{}'", text.replace('\'', r"'\''"))
            }
        };
        let mut words = vec!["loopbox fleet".to_owned(), quoted(&out.display().to_string())];
        words.extend(self.connect.iter().map(|at| format!("--connect {at}")));
        words.extend(self.listen.iter().map(|at| format!("--listen {at}")));
        let keys = self.keys.folder();
        words.extend(keys.map(|keys| format!("--keys {}", quoted(&keys.display().to_string()))));
        words.join(" ")
    }

    /// Ends it once the others hold the map, after `stop` at once.
    ///
    /// # Errors
    /// When what was merged cannot be written.
    pub fn end(&self, fleet: Fleet, out: &Path, stop: &Stop, quiet: bool) -> Result<()> {
        if !fleet.hand_over(PATIENCE, stop) && !quiet {
            tell!(
                "fleet: not everybody holds all of the map; it is kept, and this tells it: {}",
                self.again(out)
            );
        }
        fleet.wait(&ended())?;
        Ok(())
    }
}

/// Runs `loopbox fleet`.
///
/// # Errors
/// When there is no party whose results are in the folder, or a process of the demonstration fails.
pub fn run(args: &FleetCommand) -> Result<()> {
    if let Some(recordings) = &args.demo {
        return demo::run(recordings, &args.out);
    }
    let folder = args.folder.as_deref().unwrap_or(Path::new("."));
    let status = read_status(folder)?;
    if !args.connect.is_empty() || args.listen.is_some() {
        return hand_over(folder, &status.name, args);
    }
    if args.json {
        console::print_json(&status)?;
    } else {
        console::print(&described(&status))?;
    }
    let not_well = |text: String| Err(Ended { ending: Ending::NotWell, text }.into());
    if status.is_stale() {
        return not_well(format!("{}: no heartbeat for {}", status.name, lasting(status.age_s())));
    }
    let silent: Vec<&str> =
        status.links.iter().filter(|link| link.why.is_some()).map(|link| &*link.name).collect();
    if !status.ended && !silent.is_empty() {
        return not_well(format!("{}: no answer from {}", status.name, silent.join(", ")));
    }
    Ok(())
}

/// Tells what a run kept for neighbours that were not there, and takes theirs.
fn hand_over(folder: &Path, name: &str, args: &FleetCommand) -> Result<()> {
    let options = FleetOptions {
        store: None,
        out: folder.to_owned(),
        force: false,
        name: name.to_owned(),
        is_station: false,
        in_background: false,
        listen: args.listen.clone(),
        dial: args.connect.clone(),
        keys: args.keys.folder(),
    };
    let stop = stop_on_ctrl_c("stopping (Ctrl-C again to abort)")?;
    let report = |level, text: &str| logging::write(level, "", format_args!("{text}"));
    let fleet = Fleet::start(&options, None, report, Vec::new())?;
    if let Some(at) = fleet.listening() {
        tell!("others reach this agent by --connect {}", at.for_others());
    }
    // Who listens waits for others to come.
    let patience = if args.listen.is_some() { Duration::MAX } else { PATIENCE };
    let is_handed_over = fleet.hand_over(patience, &stop);
    // What is missing of others' maps is theirs to tell again.
    fleet.fetch_all(&stop);
    fleet.wait(&ended())?;
    if !is_handed_over {
        bail!(
            "{}: nobody holds all of this map\nhint: is there a station at {}? `loopbox fleet {}` says who answered",
            folder.display(),
            args.connect.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "),
            folder.display()
        );
    }
    Ok(())
}

/// The wish to stop, at once.
fn ended() -> Stop {
    let stop = Stop::default();
    stop.request();
    stop
}

/// A time that passed, for people.
fn lasting(seconds: f64) -> String {
    match seconds {
        ..120.0 => format!("{seconds:.0} s"),
        ..7200.0 => format!("{:.0} min", seconds / 60.0),
        _ => format!("{:.0} h", seconds / 3600.0),
    }
}

/// How a link of a party is, which may have ended, for people.
fn of_link(link: &LinkLine, has_ended: bool) -> String {
    let since = lasting(link.since_s);
    if let Some(why) = &link.why {
        return format!("  {}: does not answer for {since}: {why}\n", link.name);
    }
    let place = match &link.address {
        // Nobody is linked to a party that has ended.
        Some(at) if !has_ended => format!("{at} for {since}"),
        Some(at) => at.clone(),
        None => format!("not there for {since}"),
    };
    let lacks = match link.lacks {
        Some(0) => ", holds all that is told here".into(),
        Some(count) => format!(", lacks {count} objects"),
        None => String::new(),
    };
    let silent = link.silent_s.map_or(String::new(), |silent| format!(", heard {silent:.0} s ago"));
    let twice = match link.useless / 1000 {
        0 => String::new(),
        kilobytes => format!(" ({kilobytes} of them twice)"),
    };
    let wanted = match link.wanted {
        0 => String::new(),
        count => format!(", is asked for {count} objects at {:.0} kB/s", link.rate / 1000.0),
    };
    let sent = link.received / 1000;
    format!("  {}: {place}{silent}, sent {sent} kB{twice}{wanted}{lacks}\n", link.name)
}

/// How things are, for people.
// Writing to a String cannot fail.
pub(super) fn described(status: &StatusFile) -> String {
    let mut text = String::new();
    let at = status.listening.as_ref().map_or(String::new(), |at| format!(", listening at {at}"));
    let state = match (status.ended, status.is_stale()) {
        (true, _) => format!(", ended {} ago", lasting(status.age_s())),
        (false, true) => {
            format!(": no heartbeat for {}; this is how it was then", lasting(status.age_s()))
        }
        (false, false) => at,
    };
    let _ = writeln!(text, "{}{state}", status.name);
    status.links.iter().for_each(|link| text += &of_link(link, status.ended));
    for agent in &status.agents {
        let missing = match agent.missing {
            0 => "all here".into(),
            count => format!("{count} objects missing"),
        };
        let run = if agent.finished { "run over" } else { "under way" };
        let publisher =
            agent.publisher.as_ref().map_or(String::new(), |publisher| format!(" told by {publisher}"));
        let sensor = if agent.sensor == Some(SensorKind::Lidar) { " of a LiDAR" } else { "" };
        let (name, keyframes) = (status.name_of(agent), agent.keyframes);
        let _ = writeln!(text, "  map of {name}{publisher}: {keyframes} keyframes{sensor}, {missing}, {run}");
    }
    for pair in &status.found.pair_verdicts {
        let [a, b] = &pair.names;
        let why = pair.why.as_ref().map_or(String::new(), |why| format!(": {why}"));
        let _ = writeln!(text, "  {a} + {b}: {}{why}", pair.verdict);
    }
    for trouble in &status.trouble {
        let _ = writeln!(text, "  {trouble}");
    }
    text
}

/// Puts the map of a run into a store.
///
/// # Errors
/// When the map cannot be read, or the store not be written.
pub(super) fn put(store: &Store, out: &Path) -> Result<()> {
    let (map, _) = map_file_at(out)?;
    let put = store.put_map(&map);
    put.with_context(|| format!("the map is in {}, and not in the store", map.display())).map(drop)
}
