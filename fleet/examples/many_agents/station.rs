//! The station that is measured: a process of its own.

use anyhow::{Context, Result, ensure};
use fleet::transport::Endpoint;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

/// Hertz of the times in `/proc/PID/stat`.
const TICKS: f64 = 100.0;
const PATIENCE: Duration = Duration::from_secs(30);

/// CPU seconds of the station's threads, by their names.
pub type Cpu = BTreeMap<String, f64>;

/// A station at work, which ends with this.
pub struct Station {
    process: Child,
    address: Endpoint,
}

impl Station {
    /// One that listens within this machine and works in a folder.
    pub fn start(program: &Path, keys: &Path, out: &Path) -> Result<Self> {
        let mut command = Command::new(program);
        command.args(["station", "--quiet", "--listen", "tls/127.0.0.1:0", "--keys"]).arg(keys);
        let mut process = command.arg("--out").arg(out).spawn().context("the station does not start")?;
        let begun = Instant::now();
        loop {
            let text = fs::read_to_string(out.join("fleet.json")).unwrap_or_default();
            let found = text.split_once("\"listening\":").and_then(|(_, rest)| rest.split('"').nth(1));
            if let Some(address) = found.filter(|address| address.starts_with("tls/")) {
                return Ok(Self { process, address: address.parse()? });
            }
            ensure!(
                process.try_wait()?.is_none() && begun.elapsed() < PATIENCE,
                "the station does not listen"
            );
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Where it listens.
    pub fn address(&self) -> &Endpoint {
        &self.address
    }

    /// What its threads took so far. Those of one name are one, and what ended threads took is `ended`.
    pub fn cpu(&self) -> Result<Cpu> {
        let process = format!("/proc/{}", self.process.id());
        let mut cpu = Cpu::new();
        for task in fs::read_dir(format!("{process}/task")).context("the station is gone")? {
            // A thread may end meanwhile.
            let Ok(text) = fs::read_to_string(task?.path().join("stat")) else { continue };
            let (name, seconds) = times(&text).context("no CPU time")?;
            *cpu.entry(name).or_default() += seconds;
        }
        let (_, all) = times(&fs::read_to_string(format!("{process}/stat"))?).context("no CPU time")?;
        let ended = all - cpu.values().sum::<f64>();
        cpu.insert("ended".into(), ended);
        Ok(cpu)
    }

    /// Prints what it took since `before`, of so much time, and its largest memory.
    pub fn print(&self, before: &Cpu, spent: Duration) -> Result<()> {
        let now = self.cpu()?;
        let since = now
            .iter()
            .map(|(name, cpu)| (name, (cpu - before.get(name).unwrap_or(&0.0)) / spent.as_secs_f64()));
        let shares: Vec<(&String, f64)> = since.filter(|(_, share)| *share >= 5e-4).collect();
        let all: f64 = shares.iter().map(|(_, share)| share).sum();
        let threads: Vec<String> =
            shares.iter().map(|(name, share)| format!("{name} {:.1}", 100.0 * share)).collect();
        let status = fs::read_to_string(format!("/proc/{}/status", self.process.id()))?;
        let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).map_or("?", str::trim);
        println!("station: {:.1} % of a core ({}); peak memory {peak}", 100.0 * all, threads.join(", "));
        Ok(())
    }
}

/// The name of a thread or process, and its CPU seconds.
fn times(stat: &str) -> Option<(String, f64)> {
    let (before, after) = stat.rsplit_once(')')?;
    let (_, name) = before.split_once('(')?;
    let mut fields = after.split_whitespace().skip(11).map(|field| field.parse::<f64>().ok());
    Some((name.to_owned(), (fields.next()?? + fields.next()??) / TICKS))
}

impl Drop for Station {
    fn drop(&mut self) {
        // Nothing to be done where it ended by itself.
        let _ = self.process.kill().and_then(|()| self.process.wait());
    }
}
