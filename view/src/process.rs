//! What the operating system knows of this process, and of memory.

/// Units of the times in `/proc/self/stat` per second: fixed at 100 in Linux's interface to programs.
const TICKS_PER_SECOND: f64 = 100.0;

/// CPU seconds of all threads so far; `None` where there is no `/proc`.
pub fn cpu_seconds() -> Option<f64> {
    parse_cpu_seconds(&std::fs::read_to_string("/proc/self/stat").ok()?)
}

/// Largest resident memory so far, bytes; `None` where there is no `/proc`.
pub fn peak_memory_bytes() -> Option<u64> {
    parse_memory(&std::fs::read_to_string("/proc/self/status").ok()?, "VmHWM:")
}

/// Resident memory now, bytes; `None` where there is no `/proc`.
pub fn memory_bytes() -> Option<u64> {
    parse_memory(&std::fs::read_to_string("/proc/self/status").ok()?, "VmRSS:")
}

/// Memory of the machine that programs may still take, bytes; `None` where there is no `/proc`.
pub fn available_memory_bytes() -> Option<u64> {
    parse_memory(&std::fs::read_to_string("/proc/meminfo").ok()?, "MemAvailable:")
}

/// Fields 14 and 15 (user and system time); the program's name in field 2 may hold blanks.
fn parse_cpu_seconds(stat: &str) -> Option<f64> {
    let (_, after_name) = stat.rsplit_once(')')?;
    let mut fields = after_name.split_whitespace().skip(11);
    let (user, system) = (fields.next()?.parse::<f64>().ok()?, fields.next()?.parse::<f64>().ok()?);
    Some((user + system) / TICKS_PER_SECOND)
}

fn parse_memory(status: &str, field: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix(field))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn proc_files_are_understood() {
        let stat = "42 (a (b) c) R 1 2 3 4 5 6 7 8 9 10 150 50 0 0 20 0";
        assert_eq!(parse_cpu_seconds(stat), Some(2.0));
        assert_eq!(parse_memory("Name:\tx\nVmHWM:\t   2048 kB\n", "VmHWM:"), Some(2 << 20));
        let meminfo = "MemTotal:       24047736 kB\nMemAvailable:   20000000 kB\n";
        assert_eq!(parse_memory(meminfo, "MemAvailable:"), Some(20_000_000 * 1024));
        assert_eq!(parse_memory("MemTotal: 3 kB\n", "MemAvailable:"), None);
    }
}
