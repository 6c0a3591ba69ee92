mod service;
mod service_support;
