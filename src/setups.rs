//! A document's light setups, as web pages have them.

use rekindle_output::web::Setup;
use rekindle_studio::{Document, Look};

/// All setups of a document.
pub(crate) fn of_document(document: &Document) -> Vec<Setup> {
    let looks = document.state().looks.iter();
    looks.map(|look| setup(document, look)).collect()
}

fn setup(document: &Document, look: &Look) -> Setup {
    let light = document.light_of(look);
    Setup {
        name: look.name.clone(),
        // Under any other light than the captured one the stored texture would be wrong.
        captured: look.captured && light.lighting == document.base().lighting,
        names: names(look),
        lighting: light.lighting,
    }
}

/// Names of a setup's lights, in the order of its lighting.
pub(crate) fn names(look: &Look) -> Vec<String> {
    look.lamps.iter().map(|lamp| lamp.name.clone()).collect()
}
