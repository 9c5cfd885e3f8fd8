function [mean_mm, report] = evaluate (mesh, truth)
% EVALUATE  The fitting error of a mesh, mm: the mean distance from its vertices to the truth's triangles.
%   mean_mm = lumenmesh.evaluate (mesh, truth)      structs, as lumenmesh.write describes, or the names of files
%   [mean_mm, report] = ...                         all numbers as text in JSON: jsondecode (report)
  [path, cleanup] = lumenmesh.file_of (mesh); %#ok<ASGLU>
  [truth_path, truth_cleanup] = lumenmesh.file_of (truth); %#ok<ASGLU>
  report = lumenmesh.command ('evaluate', path, '--truth', truth_path, '--json');
  numbers = jsondecode (report);
  mean_mm = numbers.mesh_to_truth.mean_mm;
end
