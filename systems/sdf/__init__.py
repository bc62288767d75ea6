"""SDFormat, collision meshes and contact coefficients of objects, floors and pushers for Drake."""
