// Workgroups are laid out in two dimensions, because one holds 65,535 at most. A third may count cylinders.

fn workgroup_index(group: vec3u, groups: vec3u) -> u32 {
    return group.y * groups.x + group.x;
}
