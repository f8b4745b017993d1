//! Whether the connected device can print a job by its recipe: checked before the part is sent, and again when it has arrived.
//! `tests/strangers.rs` shows it.

use std::path::Path;
use std::sync::Arc;

use crate::config::Recipe;
use crate::daemon::error::OrderError;
use crate::daemon::setting::Setting;
use crate::device::{Misfit, check_fit};
use crate::link::message::Capabilities;

/// What a new job's recipe is checked against.
#[derive(Clone, Debug)]
pub struct Fit {
    setting: Arc<Setting>,
    /// `None` without a device; the check then happens when the job begins.
    device: Option<Capabilities>,
}

impl Fit {
    /// A check against this machine, and against the device if one is connected.
    pub(crate) fn new(setting: Arc<Setting>, device: Option<Capabilities>) -> Self {
        Self { setting, device }
    }

    /// Checks a recipe, or the default one if `text` is `None`; returns it.
    ///
    /// # Errors
    /// 422 for a recipe that is wrong or that the device cannot print, 409 for a device that is another machine.
    pub(crate) fn check(&self, text: Option<&str>, name: Option<&str>) -> Result<Recipe, OrderError> {
        let place = Path::new(name.unwrap_or("recipe"));
        let Setting { machine, config, recipe_text, .. } = &*self.setting;
        let recipe = Recipe::parse_for(machine, &config.machine, place, text.unwrap_or(recipe_text))
            .map_err(|error| OrderError::new(422, error.to_string()))?;
        if let Some(device) = &self.device {
            check_fit(&self.setting.machine, &recipe, device).map_err(|misfit| {
                // 409 calls for another device, 422 for another recipe.
                let status = if matches!(misfit, Misfit::Machine(_)) { 409 } else { 422 };
                OrderError::new(status, misfit.to_string())
            })?;
        }
        Ok(recipe)
    }
}
