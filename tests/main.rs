mod captures;
mod crash;
mod hostile;
mod service;
mod service_api;
mod service_promises;
mod service_support;
