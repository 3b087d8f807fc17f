"""Series of many scans: designs, execution on a cluster, sensitivity analysis, reports."""
