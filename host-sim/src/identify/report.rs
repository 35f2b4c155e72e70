//! The result of an identification for a person.

use super::result::Identification;
use std::fmt;

impl fmt::Display for Identification {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "machine {}: {}", self.machine_name, self.order.join(" -> "))?;
        writeln!(f, "{:<28}{:>18}{:>14}  {:<5}{:>18}", "constant", "value", "sigma", "unit", "nominal")?;
        for e in &self.estimates {
            let digits = if e.unit == "rad" { 9 } else { 4 };
            let value = format!("{:.digits$}", e.value);
            let sigma = if e.held { "held".into() } else { format!("{:.digits$}", e.sigma) };
            let nominal = format!("{:.digits$}", e.nominal);
            writeln!(f, "{:<28}{value:>18}{sigma:>14}  {:<5}{nominal:>18}", e.name, e.unit)?;
        }
        writeln!(
            f,
            "rank {} of {} unknowns, condition {:.1e}; {} readings, chi-square {:.1} at {} degrees of freedom \
             ({})",
            self.rank,
            self.unknowns,
            self.condition,
            self.readings,
            self.chi_square,
            self.degrees_of_freedom,
            match self.probability {
                Some(probability) => format!("p = {probability:.3}"),
                None => {
                    let files = &self.noise_from_residuals;
                    let named = if files.len() > 3 { format!("{} files", files.len()) } else { files.join(", ") };
                    format!("no test of the model: the noise of {named} was taken from the residuals")
                }
            }
        )?;
        for r in &self.reversals {
            let (Some(reversal), Some(mean)) = (r.reversal, r.mean_reversal) else {
                writeln!(
                    f,
                    "{}: {} one way, scale {:+.1} ppm from {} targets and {} runs; play held at {:.1} {}",
                    r.file, r.axis, r.scale_ppm, r.targets, r.runs, r.backlash, r.unit
                )?;
                continue;
            };
            writeln!(
                f,
                "{}: {} reversal value B {:.1} {u}, mean {:+.1} {u} (ISO 230-2); play {:.1} +- {:.1} {u} from {} targets \
                 and {} runs",
                r.file,
                r.axis,
                reversal,
                mean,
                r.backlash,
                r.sigma,
                r.targets,
                r.runs,
                u = r.unit
            )?;
        }
        for file in &self.files {
            writeln!(
                f,
                "{}: {}, {} readings, {} left out, rms of the residuals {:.2} {u}, noise {:.2} {u} ({})",
                file.file,
                file.kind,
                file.readings,
                file.rejected,
                file.rms,
                file.noise,
                match file.noise_freedom {
                    _ if file.noise_stated => "stated".into(),
                    Some(freedom) => format!(
                        "estimated with {freedom:.0} degrees of freedom, its share of sigma {:.2} times larger for it",
                        file.student_factor
                    ),
                    None => "estimated".to_string(),
                },
                u = file.unit
            )?;
        }
        for outlier in &self.outliers {
            let unit = self.files.iter().find(|file| file.file == outlier.file).map_or("", |file| file.unit);
            writeln!(
                f,
                "left out: {}:{}: {} is {:+.1} {unit} off, {:.1} standard deviations",
                outlier.file,
                outlier.line,
                outlier.column,
                outlier.residual,
                outlier.studentised.abs()
            )?;
        }
        for sentence in &self.gauge {
            writeln!(f, "gauge: {sentence}")?;
        }
        for warning in &self.warnings {
            writeln!(f, "warning: {warning}")?;
        }
        Ok(())
    }
}
