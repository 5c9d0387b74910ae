//! Trajectories as text, in the forms the benchmarks use.

use super::save;
use crate::{MapError, StampedPose};
use std::io::{self, Write};
use std::path::Path;

/// Writes a trajectory in the form of the TUM RGB-D benchmark: `timestamp tx ty tz qx qy qz qw`,
/// one pose (world from camera) a line, seconds and map units. Numbers have as many digits as it
/// takes to read the same value back.
pub fn write_tum(out: &mut impl Write, trajectory: &[StampedPose]) -> io::Result<()> {
    writeln!(out, "# timestamp tx ty tz qx qy qz qw")?;
    for pose in trajectory {
        write!(out, "{}", pose.timestamp)?;
        for value in pose.world_from_camera.to_tum() {
            write!(out, " {value}")?;
        }
        writeln!(out)?;
    }
    Ok(())
}

/// Writes a trajectory in the form of the KITTI odometry benchmark: the upper 3×4 part of
/// `world_from_camera`, row by row, one pose a line. Time stamps are not part of the form.
pub fn write_kitti(out: &mut impl Write, trajectory: &[StampedPose]) -> io::Result<()> {
    for pose in trajectory {
        let matrix = pose.world_from_camera.to_matrix();
        for row in 0..3 {
            for column in 0..4 {
                let separator = if (row, column) == (0, 0) { "" } else { " " };
                write!(out, "{separator}{}", matrix[(row, column)])?;
            }
        }
        writeln!(out)?;
    }
    Ok(())
}

/// Makes a TUM trajectory file, see [`write_tum`].
pub fn save_tum(path: impl AsRef<Path>, trajectory: &[StampedPose]) -> Result<(), MapError> {
    save(path.as_ref(), |out| write_tum(out, trajectory))
}

/// Makes a KITTI trajectory file, see [`write_kitti`].
pub fn save_kitti(path: impl AsRef<Path>, trajectory: &[StampedPose]) -> Result<(), MapError> {
    save(path.as_ref(), |out| write_kitti(out, trajectory))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::sample_map;

    /// The numbers of each line that is no comment.
    fn numbers(text: &[u8]) -> Vec<Vec<f64>> {
        let lines = std::str::from_utf8(text).unwrap().lines().filter(|line| !line.starts_with('#'));
        lines.map(|line| line.split(' ').map(|word| word.parse().unwrap()).collect()).collect()
    }

    #[test]
    fn tum_reads_back_exactly() {
        let trajectory = sample_map(3).trajectory();
        let mut text = Vec::new();
        write_tum(&mut text, &trajectory).unwrap();
        let lines = numbers(&text);
        assert_eq!(lines.len(), trajectory.len());
        for (line, pose) in lines.iter().zip(&trajectory) {
            assert_eq!(line[0], pose.timestamp);
            assert_eq!(line[1..], pose.world_from_camera.to_tum());
        }
    }

    #[test]
    fn kitti_is_the_matrix_row_by_row() {
        let trajectory = sample_map(3).trajectory();
        let mut text = Vec::new();
        write_kitti(&mut text, &trajectory).unwrap();
        let lines = numbers(&text);
        assert_eq!(lines.len(), trajectory.len());
        for (line, pose) in lines.iter().zip(&trajectory) {
            let matrix = pose.world_from_camera.to_matrix();
            assert_eq!(line.len(), 12);
            assert_eq!([line[3], line[7], line[11]], [matrix.m14, matrix.m24, matrix.m34]);
            assert_eq!(line[4..7], [matrix.m21, matrix.m22, matrix.m23]);
        }
    }
}
