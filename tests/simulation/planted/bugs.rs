//! Bugs that the simulation must find, each a change of one line of the sources. `planted.rs` plants them one after the other.

/// A bug.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bug {
    /// What the program does wrong.
    pub(crate) name: &'static str,
    /// Where, from the root of the project.
    pub(crate) file: &'static str,
    /// The right code, which occurs there once.
    pub(crate) was: &'static str,
    /// The wrong code in its place.
    pub(crate) becomes: &'static str,
}

/// All bugs. Each was found within 2,000 seeds when it was added.
pub(crate) const BUGS: &[Bug] = &[
    // The journal and the spool.
    Bug {
        name: "records are not flushed",
        file: "src/job/journal.rs",
        was: "if let Err(source) = self.file.write_all_at(bytes, self.length_bytes).and_then(|()| self.file.sync_data()) {",
        becomes: "if let Err(source) = self.file.write_all_at(bytes, self.length_bytes) {",
    },
    Bug {
        name: "an exposure is not recorded before it",
        file: "src/job/engine/exposure.rs",
        was: "self.out.journal(Record::Commanded { exposure, boot_id });",
        becomes: "return self.expose(now_us);",
    },
    Bug {
        name: "no space is set aside for the last records",
        file: "src/job/journal.rs",
        was: "if self.unreserved || self.length_bytes + bytes <= self.reserved_bytes {",
        becomes: "if self.length_bytes + bytes > 0 {",
    },
    Bug {
        name: "a new job's name is not flushed",
        file: "src/job/spool.rs",
        was: "sync_parent(directory.path()).map_err(io(\"flush\", &jobs))?;",
        becomes: "",
    },
    Bug {
        name: "a new job's recipe is not flushed",
        file: "src/job/spool.rs",
        was: "file.write_all_at(text.as_bytes(), 0)?;",
        becomes: "return file.write_all_at(text.as_bytes(), 0);",
    },
    Bug {
        name: "a new directory is not flushed",
        file: "src/disk/names.rs",
        was: "made => made?,",
        becomes: "made => return made,",
    },
    Bug {
        name: "leftovers of uploads are kept",
        file: "src/job/spool.rs",
        was: "spool.delete_leftovers()?;",
        becomes: "",
    },
    // What the journal says after a crash.
    Bug {
        name: "after a crash a commanded layer counts as exposed",
        file: "src/job/history.rs",
        was: "            next_exposure: self.next_exposure,",
        becomes: "            next_exposure: self.next_exposure + u32::from(self.unconfirmed.is_some()),",
    },
    Bug {
        name: "after a crash the first exposure is forgotten",
        file: "src/job/history.rs",
        was: "touched: self.touched(),",
        becomes: "touched: self.confirmed,",
    },
    Bug {
        name: "a layer to be repeated is left out",
        file: "src/job/history.rs",
        was: "self.close(*exposed);",
        becomes: "self.close(true);",
    },
    Bug {
        name: "an order is not recorded",
        file: "src/daemon/jobs/settle.rs",
        was: "warning(if history.ordered == Some(order) { Ok(()) } else { write(Record::Ordered(order)) });",
        becomes: "warning(Ok(()));",
    },
    Bug {
        name: "an order is not carried out after a crash",
        file: "src/daemon/jobs/mod.rs",
        was: "(JobState::Interrupted, Some(order)) => self.end_later(id, order),",
        becomes: "",
    },
    Bug {
        name: "a journal that could not be read is not read again",
        file: "src/daemon/printer/event_loop.rs",
        was: "self.retry_unread();",
        becomes: "",
    },
    Bug {
        name: "an order of the running job is not recorded",
        file: "src/job/engine/abort.rs",
        was: "self.out.journal(Record::Ordered(EndOrder::Abort));",
        becomes: "",
    },
    // What became of an exposure.
    Bug {
        name: "an exposure counts once the device has the order",
        file: "src/job/engine/exposure.rs",
        was: "self.light.taken(now_us);",
        becomes: "return self.confirm(None, now_us);",
    },
    Bug {
        name: "an exposure counts when its time is over",
        file: "src/job/engine.rs",
        was: "Phase::Exposing { .. } => self.on_overdue_light(now_us),",
        becomes: "Phase::Exposing { .. } => self.confirm(None, now_us),",
    },
    Bug {
        name: "a restart of the device is not noticed",
        file: "src/job/fate.rs",
        was: "Some(commanded) if commanded.boot_id == device.boot_id => Fate::NotExposed,",
        becomes: "Some(_) => Fate::NotExposed,",
    },
    Bug {
        name: "light cut short counts as an exposure",
        file: "src/job/fate.rs",
        was: "return Fate::Unknown(format!(\"its light was cut short after {light_ms} ms{whole}\"));",
        becomes: "return Fate::Exposed;",
    },
    Bug {
        name: "a crash of the daemon starts the layer again",
        file: "src/job/engine/recovery.rs",
        was: "if self.next.known != Known::Dark {",
        becomes: "if self.next.known != Known::Dark && choice != ResumeChoice::None {",
    },
    Bug {
        name: "exposures of two jobs have one name",
        file: "src/daemon/orders/submit.rs",
        was: "let key = random::bits().max(1);",
        becomes: "let key = 1;",
    },
    // Light.
    Bug {
        name: "unwanted light is not switched off without a job",
        file: "src/daemon/printer/light.rs",
        was: "self.send_urgent(Urgent::LightOff);",
        becomes: "",
    },
    Bug {
        name: "unwanted light is not switched off during a job",
        file: "src/job/engine/light.rs",
        was: "self.out.urgent = Some(Urgent::LightOff);",
        becomes: "",
    },
    Bug {
        name: "an abort waits for the layer, like a stop",
        file: "src/job/engine.rs",
        was: "Event::Command(Command::Abort) => self.abort(now_us),",
        becomes: "Event::Command(Command::Abort) => self.command(Command::Stop, now_us),",
    },
    Bug {
        name: "the exposure takes twice its time",
        file: "src/job/cycle/vat.rs",
        was: "VatAct::Expose { layer, pass, duration_ms, light_pwm:",
        becomes: "VatAct::Expose { layer, pass, duration_ms: 2 * duration_ms, light_pwm:",
    },
    // The plate.
    Bug {
        name: "the plate is homed between two layers",
        file: "src/job/cycle/vat.rs",
        was: "None if part_possible => Step::Halt(POSITION_LOST.into()),",
        becomes: "None if part_possible && self.sticks => Step::Halt(POSITION_LOST.into()),",
    },
    Bug {
        name: "the plate goes to the height of the layer before",
        file: "src/job/cycle/vat.rs",
        was: "let to_um = self.plan.positions().layer_um(self.passes.at(exposure).layer);",
        becomes: "let to_um = self.plan.positions().layer_um(self.passes.at(exposure.saturating_sub(1)).layer);",
    },
    Bug {
        name: "a part left in the vat is forgotten",
        file: "src/daemon/printer/plate.rs",
        was: "self.jobs.left().map(|(job, key)| Sign::Left { job, key }).into_iter().collect();",
        becomes: "Vec::new();",
    },
    Bug {
        name: "a part of another spool is not noticed",
        file: "src/daemon/printer/plate.rs",
        was: "Account::Foreign => Some(Sign::Exposure { trace, seen, job: None }),",
        becomes: "Account::Foreign => None,",
    },
    Bug {
        name: "a plate in the resin is not noticed",
        file: "src/daemon/printer/plate.rs",
        was: "signs.extend(self.low_plate(state));",
        becomes: "",
    },
    Bug {
        name: "the plate is not looked at before a job",
        file: "src/daemon/printer/plate.rs",
        was: "signs.retain(|sign| !sign.is_known(&job.cleared, state));",
        becomes: "signs.clear();",
    },
    // Laser and powder.
    Bug {
        name: "marking goes on one vector too late",
        file: "src/job/cycle/powder.rs",
        was: "self.from_vector = next_vector;",
        becomes: "self.from_vector = next_vector + 1;",
    },
    Bug {
        name: "the journal has a layer marked one vector too far",
        file: "src/job/engine/exposure.rs",
        was: "self.out.journal(Record::PartlyMarked { exposure, next_vector });",
        becomes: "self.out.journal(Record::PartlyMarked { exposure, next_vector: next_vector + 1 });",
    },
    Bug {
        name: "a vector marked in part is marked again without a question",
        file: "src/job/engine/recovery.rs",
        was: "(Fate::Partly { broken: Some(why), .. }, _) if choice != ResumeChoice::Repeat => {",
        becomes: "(Fate::Partly { broken: Some(why), .. }, _) if choice == ResumeChoice::AssumeExposed => {",
    },
    Bug {
        name: "a layer that goes on is recoated again",
        file: "src/job/cycle/powder.rs",
        was: "if self.recoated {",
        becomes: "if self.recoated && self.from_vector == 0 {",
    },
    Bug {
        name: "a vector marked in part counts as not begun",
        file: "src/job/fate.rs",
        was: "powder.broken.then(|| format!",
        becomes: "false.then(|| format!",
    },
    Bug {
        name: "the plate goes down to the depth of the layer before",
        file: "src/job/cycle/powder.rs",
        was: "let to_um = self.plan.positions().layer_um(layer);",
        becomes: "let to_um = self.plan.positions().layer_um(layer.saturating_sub(1));",
    },
    Bug {
        name: "more is sent than the buffer has room for",
        file: "src/device/driver/upload.rs",
        was: "self.buffer_bytes.saturating_sub(self.in_flight_bytes())",
        becomes: "self.buffer_bytes",
    },
    Bug {
        name: "a plate that somebody moved is not noticed",
        file: "src/job/cycle/plate.rs",
        was: "state.position_um.is_some_and(|found_um| !self.is_off(found_um, left_um))",
        becomes: "state.position_um.is_some()",
    },
    Bug {
        name: "after a crash a layer begins with its first vector",
        file: "src/job/history.rs",
        was: "from_vector: self.next_vector,",
        becomes: "from_vector: 0,",
    },
    // Layers on their way.
    Bug {
        name: "a sweep begins one layer too late",
        file: "src/job/engine.rs",
        was: "wanted.new_sweep.then_some(wanted.exposure).or(self.out.need_from);",
        becomes: "wanted.new_sweep.then_some(wanted.exposure + 1).or(self.out.need_from);",
    },
    // The line.
    // Waits, memory and what operators are told.
    Bug {
        name: "the memory of the last layer is kept",
        file: "src/daemon/machine/running.rs",
        was: "drop(self.sending);",
        becomes: "std::mem::forget(self.sending);",
    },
    Bug {
        name: "one layer too many is said to be done",
        file: "src/job/engine/report.rs",
        was: "layers_done: next.layer,",
        becomes: "layers_done: next.layer + 1,",
    },
    Bug {
        name: "a pause is accepted and ignored",
        file: "src/job/engine.rs",
        was: "self.intent = Intent::Pause;",
        becomes: "",
    },
    Bug {
        name: "a stop is accepted and ignored",
        file: "src/job/engine.rs",
        was: "self.intent = Intent::End(End { state: JobState::Stopped, reason, ordered: Some(EndOrder::Stop) });",
        becomes: "let _: String = reason;",
    },
];
