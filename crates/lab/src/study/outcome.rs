//! What came of a case, and the verdict on it.

use crate::bench::Errors;

/// Errors up to these are fine: of σ and of a flux as parts, of a direction in degrees.
const FINE_SIGMA: f64 = 0.01;
const FINE_FLUX: f64 = 0.03;
const FINE_DIRECTION: f64 = 0.3;

/// What is said of a wrong σ.
const WITHIN: &str = "σ (within its interval)";
const BEYOND: &str = "σ (beyond its interval)";

/// What is said with what is wrong where the program blames the mesh.
const MESH: &str = "; the mesh is said to be off";

/// What came of a case.
#[derive(Clone, Debug)]
pub(super) enum Outcome {
    /// Roughness and lights.
    Solved(Box<Found>),
    /// Neither, and why.
    Refused(String),
    /// The program did not end as it should.
    Failed(String),
}

/// Roughness and lights compared with the truth.
#[derive(Clone, Debug)]
pub(super) struct Found {
    /// σ, radians.
    pub sigma: f64,
    /// 95 % interval of σ over the true σ, less 1.
    pub interval: Option<[f64; 2]>,
    /// How far it is from the truth.
    pub errors: Errors,
    /// Lamps found, and how many there are.
    pub lamps: [usize; 2],
    /// How well the views are reproduced, mean over them, dB.
    pub fit_db: f64,
    /// What the program says against its own result.
    pub doubt: Option<String>,
    /// Whether it says that the mesh's normals are off, so that a better mesh gives better results.
    pub blames_mesh: bool,
    /// What it took.
    pub cost: Cost,
}

/// What a solve took.
#[derive(Clone, Debug, Default)]
pub(super) struct Cost {
    /// Seconds of each of [`STAGES`]; no number where a stage was not run.
    pub stages: Vec<Option<f64>>,
    /// Seconds of the whole.
    pub total: f64,
    /// Bytes held at most, where the system tells.
    pub peak_bytes: Option<f64>,
    /// Seconds that reading and decoding the photographs and one pass over their pixels take.
    pub floor: Option<f64>,
}

/// The stages of a solve in their order.
pub(super) const STAGES: [&str; 7] = [
    "load",
    "surface",
    "hemispheres",
    "estimate",
    "texture",
    "albedo",
    "save",
];

/// How a case is to be taken.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Verdict {
    /// All errors are small.
    Fine,
    /// Some are not, in words, and nothing says so but at most the interval of σ.
    Degrades(String),
    /// Some are not, and the program says that the result is not to be trusted.
    Doubted(String),
    /// The program gives no roughness and no lights, and says why.
    Refused(String),
    /// The program crashed or did not end.
    Failed(String),
}

impl Outcome {
    /// The verdict on it.
    pub(super) fn verdict(&self) -> Verdict {
        match self {
            Self::Solved(found) => found.verdict(),
            Self::Refused(why) => Verdict::Refused(why.clone()),
            Self::Failed(why) => Verdict::Failed(why.clone()),
        }
    }

    /// Whether the result is wrong and nothing says so.
    pub(super) fn is_silently_wrong(&self) -> bool {
        self.found().is_some_and(Found::is_silently_wrong)
    }

    /// What was found, if anything was.
    pub(super) fn found(&self) -> Option<&Found> {
        match self {
            Self::Solved(found) => Some(found),
            Self::Refused(_) | Self::Failed(_) => None,
        }
    }
}

impl Found {
    /// Whether the interval of σ holds the truth.
    pub(super) fn covers(&self) -> bool {
        self.interval
            .is_some_and(|[low, high]| low <= 0.0 && high >= 0.0)
    }

    /// What is beyond what is fine, in words.
    fn wrong(&self) -> Vec<String> {
        let worse = |error: Option<f64>, fine: f64| error.is_some_and(|e| e.abs() > fine);
        let mut wrong = Vec::new();
        if worse(self.errors.sigma, FINE_SIGMA) {
            let words = if self.covers() { WITHIN } else { BEYOND };
            wrong.push(words.to_owned());
        }
        if worse(self.errors.direction_deg, FINE_DIRECTION) {
            wrong.push("directions".to_owned());
        }
        if worse(self.errors.flux, FINE_FLUX) {
            wrong.push("fluxes".to_owned());
        }
        if worse(self.errors.outside, FINE_FLUX) {
            wrong.push("false lights".to_owned());
        }
        if worse(self.errors.missing, FINE_FLUX) {
            wrong.push("missing lights".to_owned());
        }
        wrong
    }

    /// Whether something is wrong that neither the interval of σ nor a doubt says, nor that the mesh is to blame.
    fn is_silently_wrong(&self) -> bool {
        let known = |what: &String| what == WITHIN;
        self.doubt.is_none() && !self.blames_mesh && !self.wrong().iter().all(known)
    }

    fn verdict(&self) -> Verdict {
        let wrong = self.wrong();
        match &self.doubt {
            Some(doubt) => Verdict::Doubted(doubt.clone()),
            None if wrong.is_empty() => Verdict::Fine,
            None if self.blames_mesh => Verdict::Degrades(wrong.join(", ") + MESH),
            None => Verdict::Degrades(wrong.join(", ")),
        }
    }
}

impl Verdict {
    /// In a word.
    pub(super) fn word(&self) -> &'static str {
        match self {
            Self::Fine => "fine",
            Self::Degrades(_) => "degrades",
            Self::Doubted(_) => "doubted",
            Self::Refused(_) => "refused",
            Self::Failed(_) => "failed",
        }
    }

    /// What is said with it.
    pub(super) fn words(&self) -> &str {
        match self {
            Self::Fine => "",
            Self::Degrades(words)
            | Self::Doubted(words)
            | Self::Refused(words)
            | Self::Failed(words) => words,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(sigma: f64, half_width: f64) -> Found {
        Found {
            sigma: 0.1 * (1.0 + sigma),
            interval: Some([sigma - half_width, sigma + half_width]),
            errors: Errors {
                sigma: Some(sigma),
                direction_deg: Some(0.1),
                flux: Some(0.01),
                outside: Some(0.0),
                missing: Some(0.0),
                hemisphere: None,
            },
            lamps: [1, 1],
            fit_db: 40.0,
            doubt: None,
            blames_mesh: false,
            cost: Cost::default(),
        }
    }

    #[test]
    fn a_verdict_says_whether_the_interval_knows() {
        assert_eq!(found(0.002, 0.001).verdict(), Verdict::Fine);
        let words = |found: Found| found.verdict().words().to_owned();
        assert_eq!(words(found(0.05, 0.06)), "σ (within its interval)");
        assert_eq!(words(found(-0.05, 0.01)), "σ (beyond its interval)");
        assert!(!found(0.05, 0.06).is_silently_wrong());
        assert!(found(-0.05, 0.01).is_silently_wrong());
        let mut stray = found(0.0, 0.01);
        stray.errors.outside = Some(0.1);
        assert!(stray.is_silently_wrong());
        assert_eq!(words(stray.clone()), "false lights");
        stray.blames_mesh = true;
        assert!(!stray.is_silently_wrong());
        assert_eq!(words(stray), "false lights; the mesh is said to be off");
        let mut short = found(0.0, 0.01);
        short.errors.missing = Some(0.1);
        assert_eq!(words(short), "missing lights");
        let mut doubted = found(0.05, 0.01);
        doubted.doubt = Some("Why.".to_owned());
        doubted.errors.direction_deg = Some(2.0);
        assert!(!doubted.is_silently_wrong());
        assert_eq!(doubted.verdict(), Verdict::Doubted("Why.".to_owned()));
    }
}
