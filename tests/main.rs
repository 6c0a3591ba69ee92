//! Black-box tests of the service and the command line: one module per topic, one binary.

// Test helpers may panic: the panic names the place.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod architecture;
#[cfg(target_os = "linux")]
mod archive_memory;
mod backup;
mod calibrate;
mod capture_check;
mod closed_pipes;
mod colour_chart;
mod crash;
mod deletion;
mod doctor;
mod errors;
mod eval;
#[cfg(target_os = "linux")]
mod faults;
mod fetching;
#[cfg(target_os = "linux")]
mod full_disk;
mod fuzz;
mod hostile;
mod job_machine;
mod kills;
mod light_groups;
mod light_matrix;
mod metadata;
mod nul_characters;
mod on_postgres;
mod poses;
mod promises;
mod quality_gate;
mod render_sequence;
mod s3;
mod scene_figures;
mod schedulers;
mod server_process;
mod service;
mod service_answers;
mod service_api;
mod service_calibration;
mod service_cameras;
mod service_cli;
mod service_description;
mod service_exports;
mod service_fairness;
mod service_file_forms;
mod service_keys;
mod service_lists;
mod service_load;
mod service_memory;
mod service_network;
mod service_origins;
mod service_photographs;
mod service_poses;
mod service_previews;
mod service_promises;
mod service_share;
mod service_signed_urls;
mod service_support;
mod service_tenants;
mod service_thumbnails;
mod service_upload_answers;
mod service_uploads;
mod service_validation;
mod service_viewer;
mod service_views;
mod service_web;
mod stored_files;
mod traces;
mod upgrades;
mod usage;
mod webhooks;
mod workers;
