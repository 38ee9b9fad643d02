"""Linear systems with named ports: state space, uncertain, sampled; interconnection and conversion."""
