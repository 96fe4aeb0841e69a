//! The process that hands out tasks. Its state is in memory: when it dies, clients submit unfinished jobs again.

use std::net::SocketAddr;
use std::sync::Arc;

use ballista_core::config::TaskSchedulingPolicy;
use ballista_core::serde::protobuf::scheduler_grpc_server::SchedulerGrpcServer;
use ballista_core::serde::{BallistaCodec, BallistaLogicalExtensionCodec};
use ballista_scheduler::cluster::BallistaCluster;
use ballista_scheduler::config::SchedulerConfig;
use ballista_scheduler::scheduler_server::SchedulerServer;
use datafusion_proto::protobuf::{LogicalPlanNode, PhysicalPlanNode};
use tonic::service::interceptor::InterceptedService;
use tonic::transport::server::TcpIncoming;

use super::codec::Codec;
use super::metrics::{self, Jobs, Process};
use super::network::{Address, MAX_MESSAGE_BYTES, Network, SameBuild, text};
use crate::EngineError;

/// Seconds without a sign of an executor after which its tasks are given to others. An executor gives one every second.
const EXECUTOR_SECONDS: u64 = 4;

/// A scheduler.
#[derive(Debug, Clone)]
pub struct Scheduler {
    /// Where it listens.
    pub listen: Address,
    /// Where it answers `GET /metrics`, if anywhere.
    pub metrics: Option<Address>,
}

impl Scheduler {
    /// Serves until the process ends. Calls `ready` once it listens.
    ///
    /// # Errors
    /// An address of another machine without certificates, or that is taken; certificates that are none.
    pub async fn serve(self, network: &Network, ready: impl FnOnce(SocketAddr)) -> Result<(), EngineError> {
        let Address { host, port } = self.listen.clone();
        network.check("--listen", &self.listen)?;
        let failed = |error: &dyn std::error::Error| EngineError::refused("scheduler", text(error));
        let config = SchedulerConfig {
            bind_host: host.clone(),
            external_host: host.clone(),
            bind_port: port,
            // Executors ask for tasks: a scheduler never connects to one, and needs no certificate of a client.
            scheduling_policy: TaskSchedulingPolicy::PullStaged,
            grpc_server_max_decoding_message_size: MAX_MESSAGE_BYTES as u32,
            grpc_server_max_encoding_message_size: MAX_MESSAGE_BYTES as u32,
            executor_timeout_seconds: EXECUTOR_SECONDS,
            expire_dead_executor_interval_seconds: 1,
            no_executors_grace_period_seconds: 30 * EXECUTOR_SECONDS,
            finished_job_data_clean_up_interval_seconds: 60,
            finished_job_state_clean_up_interval_seconds: 600,
            ..SchedulerConfig::default()
        };
        let cluster = BallistaCluster::new_from_config(&config).await.map_err(|error| failed(&error))?;
        let (jobs, executors) = (Arc::<Jobs>::default(), cluster.cluster_state());
        let codec = BallistaCodec::new(
            Arc::new(BallistaLogicalExtensionCodec::default()),
            Arc::new(Codec::default()),
        );
        let endpoint = config.scheduler_endpoint();
        let mut scheduler: SchedulerServer<LogicalPlanNode, PhysicalPlanNode> =
            SchedulerServer::new(endpoint, cluster, codec, Arc::new(config), jobs.clone());
        scheduler.init().await.map_err(|error| failed(&error))?;
        if let Some(address) = &self.metrics {
            metrics::serve(Process::Scheduler(jobs, executors), address).await?;
        }
        let service = SchedulerGrpcServer::new(scheduler)
            .max_decoding_message_size(MAX_MESSAGE_BYTES)
            .max_encoding_message_size(MAX_MESSAGE_BYTES);
        let listener = tokio::net::TcpListener::bind((host.trim_matches(['[', ']']), port)).await?;
        ready(listener.local_addr()?);
        let served = network
            .server()?
            .add_service(InterceptedService::new(service, SameBuild))
            .serve_with_incoming(TcpIncoming::from(listener).with_nodelay(Some(true)));
        served.await.map_err(|error| failed(&error))
    }
}
