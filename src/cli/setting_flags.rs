//! The flags of `relume train` for the training settings without a flag of their own.

use clap::{Arg, ArgMatches, Args, Command, FromArgMatches};
use relume_spec::training::{Setting, settings};

/// Settings whose flags `relume train` declares itself, or that have none: `light_rotations` is set by `--set`.
const ELSEWHERE: [&str; 8] = [
    "iterations",
    "resolution",
    "seed",
    "method",
    "white_balance",
    "crop",
    "light_rotations",
    "turntable_capture",
];

/// Settings given by flags, as pairs of `--set`.
#[derive(Debug, Clone, Default)]
pub(super) struct SettingFlags(pub(super) Vec<String>);

fn with_flag() -> impl Iterator<Item = Setting> {
    settings().into_iter().filter(|setting| !ELSEWHERE.contains(&setting.path.as_str()))
}

impl Args for SettingFlags {
    fn augment_args(command: Command) -> Command {
        with_flag().fold(command, |command, setting| {
            let heading = match setting.group() {
                Some(group) => format!("Settings: {group}"),
                None => "Settings".to_owned(),
            };
            let range = setting.range.as_ref().filter(|_| setting.group().is_some());
            let help = match range {
                Some(range) => format!("{} {range}", setting.documentation),
                None => setting.documentation.clone(),
            };
            command.arg(
                Arg::new(setting.path.clone())
                    .long(setting.flag())
                    .value_name("VALUE")
                    .help(help)
                    .help_heading(heading)
                    .hide_short_help(true)
                    .allow_hyphen_values(true),
            )
        })
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for SettingFlags {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let given = with_flag().filter_map(|setting| {
            let value = matches.get_one::<String>(&setting.path)?;
            Some(format!("{}={value}", setting.path))
        });
        Ok(Self(given.collect()))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(arguments: &[&str]) -> Result<Vec<String>, clap::Error> {
        let command = SettingFlags::augment_args(Command::new("train").no_binary_name(true));
        let matches = command.try_get_matches_from(arguments)?;
        SettingFlags::from_arg_matches(&matches).map(|flags| flags.0)
    }

    #[test]
    fn flags_become_pairs_of_settings() {
        let pairs = read(&["--max-gaussians", "2000", "--weights-smooth-roughness", "0.5"]).unwrap();
        assert_eq!(pairs, ["max_gaussians=2000", "weights.smooth_roughness=0.5"]);
        assert!(read(&["--weights-nothing", "1"]).is_err());
        assert!(read(&[]).unwrap().is_empty());
    }
}
