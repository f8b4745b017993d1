//! What a grbl controller says, line by line. Fields of a status come and go from report to report, so they are found by name. `tests/grbl/main.rs` prints
//! with it.

/// Longest line that is taken, bytes. The longest of grblHAL, its list of options, has about 250.
const MAX_LINE_BYTES: usize = 512;

/// One line from the controller.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Answer {
    /// A line was taken.
    Ok,
    /// A line was refused, and why.
    Error(u16),
    /// The controller has locked itself, and why.
    Alarm(u16),
    /// The controller has started or was reset. Its name and version.
    Banner(String),
    /// An answer to `?`.
    Status(Status),
    /// A line of `$$`.
    Setting(u16, f64),
    /// Of `$I`: blocks of the planner, and size of the receive buffer, bytes.
    Options(u32, u32),
    /// Of `$#`: the offset of the coordinate system G54, micrometres.
    Offset([i32; 3]),
    /// Of `$G`: the modes.
    Modes(String),
    /// Of `$#`: the offset that G92 has set, micrometres.
    Shift([i32; 3]),
    /// A message that needs no reaction.
    Other,
    /// No line of a grbl controller.
    Garbage(String),
}

/// An answer to `?`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Status {
    pub(super) state: State,
    /// Position in the machine's coordinates, micrometres.
    pub(super) machine_um: Option<[i32; 3]>,
    /// Position in the coordinates of the present offsets, micrometres.
    pub(super) work_um: Option<[i32; 3]>,
    /// Sum of the present offsets, micrometres.
    pub(super) offset_um: Option<[i32; 3]>,
}

/// What the controller is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum State {
    /// At rest.
    Idle,
    /// Moving by a program, a jog or a homing.
    Moving,
    /// Held by a feed hold, a door, or a tool change.
    Held,
    /// Locked until it is unlocked or homed.
    Alarm,
    /// Checks lines without moving, or sleeps.
    Off,
}

/// Puts bytes together to lines.
#[derive(Debug, Default)]
pub(super) struct Lines {
    line: Vec<u8>,
}

impl Lines {
    /// Takes bytes; returns the lines that they end.
    pub(super) fn receive(&mut self, bytes: &[u8]) -> Vec<Answer> {
        let mut answers = Vec::new();
        for &byte in bytes {
            match byte {
                b'\n' | b'\r' => {
                    let line = std::mem::take(&mut self.line);
                    if !line.is_empty() {
                        answers.push(Answer::of(&String::from_utf8_lossy(&line)));
                    }
                }
                _ if self.line.len() < MAX_LINE_BYTES => self.line.push(byte),
                _ => {
                    let line = std::mem::take(&mut self.line);
                    answers.push(garbage(&String::from_utf8_lossy(&line)));
                }
            }
        }
        answers
    }

    /// Forgets a line that has begun.
    pub(super) fn clear(&mut self) {
        self.line.clear();
    }
}

impl Answer {
    /// What a line says, without its end.
    fn of(line: &str) -> Self {
        let line = line.trim();
        if line == "ok" {
            return Self::Ok;
        }
        if let Some(status) = line.strip_prefix('<').and_then(|rest| rest.strip_suffix('>')) {
            return Status::of(status).map_or_else(|| garbage(line), Self::Status);
        }
        if let Some(inner) = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            return Self::of_bracket(inner).unwrap_or_else(|| garbage(line));
        }
        let numbered = |prefix: &str| line.strip_prefix(prefix).and_then(|rest| rest.trim().parse().ok());
        if let Some(number) = numbered("error:") {
            return Self::Error(number);
        }
        if let Some(number) = numbered("ALARM:") {
            return Self::Alarm(number);
        }
        if let Some((name, _)) = line.split_once(" [").filter(|(name, _)| name.to_lowercase().starts_with("grbl")) {
            return Self::Banner(name.chars().take(40).collect());
        }
        if let Some((number, value)) = line.strip_prefix('$').and_then(|rest| rest.split_once('=')) {
            // Settings that are texts, and the start-up lines `$N0=`, are of no use here.
            return match (number.parse(), value.parse::<f64>()) {
                (Ok(number), Ok(value)) if value.is_finite() => Self::Setting(number, value),
                _ => Self::Other,
            };
        }
        // A start-up line that was carried out.
        if line.starts_with('>') && line.contains(':') {
            return Self::Other;
        }
        garbage(line)
    }

    /// A message in square brackets; `None` if it is one of those that matter, and cannot be read.
    fn of_bracket(inner: &str) -> Option<Self> {
        let (name, value) = inner.split_once(':').unwrap_or((inner, ""));
        Some(match name {
            "OPT" => {
                let mut numbers = value.split(',').skip(1).map(str::parse);
                let (Some(Ok(blocks)), Some(Ok(bytes))) = (numbers.next(), numbers.next()) else { return None };
                Self::Options(blocks, bytes)
            }
            "G54" => Self::Offset(position_um(value)?),
            "G92" => Self::Shift(position_um(value)?),
            "GC" => Self::Modes(value.into()),
            _ => Self::Other,
        })
    }
}

impl Status {
    /// Of a report without its angle brackets; `None` if it is none.
    fn of(report: &str) -> Option<Self> {
        let mut fields = report.split('|');
        // `Hold:0`, `Door:2`, `Alarm:11`: what follows the colon is of no use here.
        let state = match fields.next()?.split(':').next()? {
            "Idle" => State::Idle,
            "Run" | "Jog" | "Home" => State::Moving,
            "Hold" | "Door" | "Tool" => State::Held,
            "Alarm" => State::Alarm,
            "Check" | "Sleep" => State::Off,
            _ => return None,
        };
        let mut status = Self { state, machine_um: None, work_um: None, offset_um: None };
        for field in fields {
            let (name, value) = field.split_once(':').unwrap_or((field, ""));
            match name {
                "MPos" => status.machine_um = Some(position_um(value)?),
                "WPos" => status.work_um = Some(position_um(value)?),
                "WCO" => status.offset_um = Some(position_um(value)?),
                _ => {}
            }
        }
        Some(status)
    }
}

/// Three or more numbers in millimetres, as micrometres; `None` if they are not, or a number is beyond 100 m.
fn position_um(text: &str) -> Option<[i32; 3]> {
    let mut numbers = text.split(',').map(|number| {
        let mm: f64 = number.parse().ok()?;
        (mm.abs() < 1e5).then(|| (mm * 1000.0).round() as i32)
    });
    Some([numbers.next()??, numbers.next()??, numbers.next()??])
}

fn garbage(line: &str) -> Answer {
    let shown = line.chars().take(40).collect::<String>();
    Answer::Garbage(crate::text::plain_line(&shown))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(line: &str) -> Answer {
        let mut answers = Lines::default().receive(format!("{line}\r\n").as_bytes());
        assert_eq!(answers.len(), 1, "{line}");
        answers.remove(0)
    }

    #[test]
    fn lines_of_both_firmwares_are_read() {
        assert_eq!(read("ok"), Answer::Ok);
        assert_eq!(read("error:9"), Answer::Error(9));
        assert_eq!(read("ALARM:3"), Answer::Alarm(3));
        assert_eq!(read("Grbl 1.1h ['$' for help]"), Answer::Banner("Grbl 1.1h".into()));
        assert_eq!(read("GrblHAL 1.1f ['$' or '$HELP' for help]"), Answer::Banner("GrblHAL 1.1f".into()));
        assert_eq!(read("$110=500.000"), Answer::Setting(110, 500.0));
        assert_eq!(read("$N0=G54"), Answer::Other);
        assert_eq!(read("[OPT:V,15,128]"), Answer::Options(15, 128));
        assert_eq!(read("[OPT:VNMGL,35,1024,3,0]"), Answer::Options(35, 1024));
        assert_eq!(read("[G54:1.500,-2.000,0.000]"), Answer::Offset([1500, -2000, 0]));
        assert_eq!(read("[G92:0.000,0.000,-0.300]"), Answer::Shift([0, 0, -300]));
        assert_eq!(read("[MSG:'$H'|'$X' to unlock]"), Answer::Other);
        assert_eq!(read(">G54:ok"), Answer::Other);
    }

    #[test]
    fn fields_of_a_status_are_found_by_name() {
        let status = |line| match read(line) {
            Answer::Status(status) => status,
            other => panic!("{other:?}"),
        };
        let full = status("<Run|WPos:1.000,2.000,-0.050,0.000|Bf:15,128|FS:500,0|WCO:0.000,0.000,1.000|A:S>");
        assert_eq!((full.state, full.machine_um), (State::Moving, None));
        assert_eq!((full.work_um, full.offset_um), (Some([1000, 2000, -50]), Some([0, 0, 1000])));
        assert_eq!(status("<Alarm:11|MPos:0.000,0.000,0.000>").state, State::Alarm);
        assert_eq!(status("<Idle>").machine_um, None);
    }

    #[test]
    fn anything_else_is_garbage() {
        for line in ["o", "<Idle|MPos:1.0,x,2.0>", "<Dance>", "error:", "[OPT:V]", "\u{fffd}k", "<Idle|MPos:1e9,0,0>"] {
            assert!(matches!(read(line), Answer::Garbage(_)), "{line}");
        }
        let long = vec![b'x'; 2 * MAX_LINE_BYTES];
        assert!(matches!(Lines::default().receive(&long)[..], [Answer::Garbage(_)]));
    }
}
