function write (data, path)
% WRITE  Writes a recording or a mesh, a struct, to a file.
%   A recording has Ep (F x 3, mm) and rotm (3 x 3 x F), the tracker's sensor in the world, and x_data, y_data (F x M, mm),
%   the wall in the probe's plane with NaN where a ray has no echo; time_s (F x 1) if it is known. It is written as .mat.
%   A mesh has vertices (V x 3, mm) and faces (T x 3, counted from 1); other fields with V numbers are arrays over its
%   vertices. It is written as .mat, .vtp, .ply, .stl or .obj.
  if ~isstruct (data)
    error ('lumenmesh:arguments', 'data: found a %s, expected a struct', class (data));
  end
  is_mesh = isfield (data, 'vertices') && isfield (data, 'faces');
  is_recording = isfield (data, 'Ep') && isfield (data, 'x_data');
  if ~is_mesh && ~is_recording
    error ('lumenmesh:arguments', 'data: found fields %s, expected vertices and faces, or Ep, rotm, x_data and y_data', ...
           strjoin (fieldnames (data)', ', '));
  end
  if is_mesh
    data.faces = double (data.faces);
  end
  [~, ~, ending] = fileparts (path);
  if strcmpi (ending, '.mat')
    store (path, data);
    return
  end
  if ~is_mesh
    error ('lumenmesh:arguments', '%s: a recording is written as .mat', path);
  end
  file = [tempname '.mat'];
  cleanup = onCleanup (@() lumenmesh.forget (file));
  store (file, data);
  lumenmesh.command ('convert', file, '-o', path);
end

% The fields as variables. Octave wants its options first.
function store (path, data)
  if exist ('OCTAVE_VERSION', 'builtin')
    save ('-v7', path, '-struct', 'data');
  else
    save (path, '-struct', 'data', '-v7');
  end
end
